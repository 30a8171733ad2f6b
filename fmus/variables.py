"""The FMUs' variables: a `variables.toml` joined with the defaults of `cosim.model.params`.

Renders a table as the C header that the kernel compiles with. What the model descriptions make
of it is the business of `fmus.description`.
"""

import tomllib
from dataclasses import dataclass
from typing import Any

from cosim.model import params
from fmus.models import Model, read_text

TIME_REFERENCE = 0


@dataclass(frozen=True)
class Variable:
    """One variable of the FMU.

    Attributes:
        name: as in the model description and, for inputs and parameters, in the C code.
        reference: value reference, the same in FMI 2 and FMI 3.
        causality: "input", "output", "parameter", "structuralParameter" or "local".
        type: "Float64", "Boolean", "Enumeration", "Int64" or "UInt64".
        description: one line for people.
        unit: unit symbol; None where the type is not Float64.
        display_unit: unit to show values in, or None.
        start: start value of inputs and parameters, the same of all elements, else None.
        min: least value, inclusive, or None.
        max: greatest value, inclusive, or None.
        nominal: typical size, or None.
        depends: names of the inputs that determine it at any moment.
        parameters: names of the parameters that determine it at the start.
        items: (name, description) of each choice of an Enumeration, counted from 1.
        dimensions: names of the structural parameters that an array has the lengths of, the last
            one's elements next to each other; none of a scalar.
        tunable: whether a parameter may change while the model runs.
    """

    name: str
    reference: int
    causality: str
    type: str
    description: str
    unit: str | None = None
    display_unit: str | None = None
    start: float | bool | int | None = None
    min: float | None = None
    max: float | None = None
    nominal: float | None = None
    depends: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    items: tuple[tuple[str, str], ...] = ()
    dimensions: tuple[str, ...] = ()
    tunable: bool = False


@dataclass(frozen=True)
class Unit:
    """A unit in terms of SI base units, and the units it may be shown in.

    Attributes:
        name: unit symbol.
        base: exponent of each SI base unit and of rad.
        display: factor from this unit to each display unit.
    """

    name: str
    base: dict[str, int]
    display: dict[str, float]


@dataclass(frozen=True)
class Table:
    """All variables in the order of their value references, and the units they use.

    Attributes:
        name: of the model.
        description: of the model, one line for people.
        variables: all but the time.
        units: of the variables.
    """

    name: Model
    description: str
    variables: tuple[Variable, ...]
    units: tuple[Unit, ...]

    def group(self, causality: str, type: str = "Float64") -> tuple[Variable, ...]:  # noqa: A002
        """Variables of one causality and type; their value references are contiguous."""
        return tuple(v for v in self.variables if v.causality == causality and v.type == type)

    def __getitem__(self, name: str) -> Variable:
        """Variable of that name.

        Raises:
            KeyError: there is none.
        """
        for variable in self.variables:
            if variable.name == name:
                return variable
        raise KeyError(name)


# Tables of variables.toml in the order of their value references, with the causality of each.
_GROUPS = {
    "input": "input",
    "output": "output",
    "parameter": "parameter",
    "option": "parameter",
    "local": "local",
    "discrete": "input",
    "structural": "structuralParameter",
}


def load_table(model: Model = "VibrationMotor") -> Table:
    """Read a model's variables; defaults, units and descriptions from `cosim.model.params`.

    Args:
        model: what the FMU is of.

    Raises:
        KeyError: the table names a parameter that `cosim.model.params` does not have.
    """
    raw = tomllib.loads(read_text(model, "variables.toml"))
    units = tomllib.loads(read_text(model, "units.toml"))
    about = raw["model"][model]
    rows = [
        (causality, row)
        for group, causality in _GROUPS.items()
        for row in raw.get(group, ())
        if row.pop("only", model) == model
    ]
    displays = {name: next(iter(unit.get("display", ())), None) for name, unit in units.items()}
    variables = tuple(
        _variable(causality, reference, row, displays, about)
        for reference, (causality, row) in enumerate(rows, start=TIME_REFERENCE + 1)
    )
    used = {variable.unit for variable in variables}
    defined = (Unit(name, u["base"], u.get("display", {})) for name, u in units.items())
    shown = tuple(unit for unit in defined if unit.name in used)
    return Table(model, about["description"], variables, shown)


def _variable(
    causality: str,
    reference: int,
    row: dict[str, Any],
    displays: dict[str, str | None],
    about: dict[str, Any],
) -> Variable:
    row["type"] = row.get("type", "Float64")
    usual = () if row.pop("scalar", False) or "dimension" not in about else (about["dimension"],)
    row["dimensions"] = tuple(row.get("dimensions", usual))
    for key in ("depends", "parameters"):
        row[key] = tuple(row.get(key, ()))
    row["items"] = tuple((item["name"], item["description"]) for item in row.get("items", ()))
    record = row.pop("record", None)
    row["tunable"] = (record or row["name"]) in about.get("tunable", ())
    if record:
        value, quantity = params.describe(getattr(params, record))[row.pop("field", row["name"])]
        row = {"description": quantity.description, "unit": quantity.unit, "start": value} | row
    elif causality in {"input", "parameter"}:
        row = {"start": 0.0} | row
    row["display_unit"] = displays[row["unit"]] if "unit" in row else None
    return Variable(causality=causality, reference=reference, **row)


def render_header(table: Table, token: str) -> str:
    """C header with value references, start values and limits.

    Args:
        table: the variables.
        token: instantiation token that ties the binary to its model description.
    """
    inputs, parameters = table.group("input"), table.group("parameter")
    options = list(table.group("parameter", "Boolean"))
    options += table.group("parameter", "Enumeration")
    structural = table.group("structuralParameter", "UInt64")
    references = [f"VR_time = {TIME_REFERENCE}"]
    references += [f"VR_{v.name} = {v.reference}" for v in table.variables]

    def array(name: str, values: list[str]) -> str:
        return f"static const double {name}[] = {{{', '.join(values)}}};"

    tunable = ", ".join(str(v.tunable).lower() for v in parameters)
    names = ", ".join(f'"{name}"' for name in ["time", *(v.name for v in table.variables)])
    lines = [
        "/* Generated by fmus/build.py from variables.toml and cosim/model/params.py. */",
        "#ifndef VARIABLES_H",
        "#define VARIABLES_H",
        f'#define INSTANTIATION_TOKEN "{token}"',
        f"enum {{ {', '.join(references)} }};",
        f"enum {{ VARIABLE_COUNT = {1 + len(table.variables)} }};",
        f"enum {{ INPUT_FIRST = {inputs[0].reference}, INPUT_COUNT = {len(inputs)} }};",
        f"enum {{ PARAMETER_FIRST = {parameters[0].reference}, "
        f"PARAMETER_COUNT = {len(parameters)} }};",
        f"#define INPUT_FIELDS double {', '.join(v.name for v in inputs)};",
        f"#define PARAMETER_FIELDS double {', '.join(v.name for v in parameters)};",
        *(f"enum {{ START_{v.name} = {int(v.start or 0)} }};" for v in (*options, *structural)),
        *(f"enum {{ LEAST_{v.name} = {v.min}, MOST_{v.name} = {v.max} }};" for v in structural),
        array("input_start", [repr(float(v.start or 0)) for v in inputs]),
        array("parameter_start", [repr(float(v.start or 0)) for v in parameters]),
        array("parameter_min", [_limit(v.min, "-") for v in parameters]),
        array("parameter_max", [_limit(v.max, "") for v in parameters]),
        f"static const bool parameter_tunable[] = {{{tunable}}};",
        f"static const char *const variable_name[] = {{{names}}};",
        "#endif",
    ]
    return "\n".join(lines) + "\n"


def _limit(value: float | None, sign: str) -> str:
    return f"{sign}INFINITY" if value is None else repr(float(value))

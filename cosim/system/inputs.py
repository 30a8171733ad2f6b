"""Inputs that are given over time: as arrays, functions, or columns of a file."""

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pyarrow import ArrowInvalid, ArrowNotImplementedError, csv, parquet

from cosim.base.reading import Kind, parsing, require_file
from cosim.fmi.fmu import Fmu
from cosim.fmi.units import UnitUse, base_unit, unit_use
from cosim.system.graph import DTYPES, Connection, GraphError, Link, Node, convert, find

_TABLE = Kind(
    "input table", "write it as .csv or .parquet, times in s in the column time", GraphError
)
_UNIT = re.compile(r"(.*?)\s*\[\s*([^\[\]]*?)\s*\]")  # behind a name
_EXACT = 2**53  # the largest integer up to which values as float64 are exact
Series = tuple[Sequence[float] | np.ndarray, Sequence[float] | np.ndarray]
Given = Series | Callable[[np.ndarray], np.ndarray]  # times in s and values, or a function of times


class Input(NamedTuple):
    """Values of an input over time.

    Attributes:
        target: component and variable.
        time_s: (n,), not decreasing.
        values: (n,).
    """

    target: Node
    time_s: np.ndarray
    values: np.ndarray


def check_inputs(
    fmus: Mapping[str, Fmu], links: Sequence[Link], inputs: Mapping[str, Given]
) -> dict[Node, tuple[str, Given]]:
    """Return types of inputs over time and their values, by component and variable.

    Raises:
        GraphError: one is no input, or has a connection.
    """
    found: dict[Node, tuple[str, Given]] = {}
    taken = {(c, fmus[c].variables[name].valueReference) for c, name in (k.target for k in links)}
    for name, given in inputs.items():
        node = find(fmus, name)
        variable = fmus[node[0]].variables[node[1]]
        if variable.causality != "input":
            raise GraphError(f"{name} is of causality {variable.causality}; give inputs over time")
        if variable.type in ("String", "Binary", "Clock"):
            raise GraphError(f"{name} is of type {variable.type}; give numbers or Boolean")
        if (node[0], variable.valueReference) in taken:
            raise GraphError(f"{name} is set by a connection or twice; remove one")
        taken.add((node[0], variable.valueReference))
        found[node] = str(variable.type), given
    return found


def check_values(node: Node, kind: str, times: object, values: object) -> Input:
    """Return values of an input of a type; raises GraphError where it cannot have them."""
    said = f"input {'.'.join(node)}"
    try:
        time_s, found = (np.asarray(each, dtype=float) for each in (times, values))
    except (TypeError, ValueError) as error:
        raise GraphError(f"{said} has values that are not numbers; correct them") from error
    if time_s.ndim != 1 or time_s.shape != found.shape or not len(time_s):
        raise GraphError(
            f"{said} has times of shape {time_s.shape} and values of shape {found.shape}; give as "
            "many values as times, one or more"
        )
    if not (
        np.isfinite(time_s).all() and np.isfinite(found).all() and (np.diff(time_s) >= 0).all()
    ):
        raise GraphError(f"{said} needs finite values, and finite times that do not decrease")
    if not kind.startswith(("Real", "Float")):
        range_ = np.iinfo(DTYPES.get(kind, "i4"))
        least, most = max(range_.min, -_EXACT), min(range_.max, _EXACT)
        if kind == "Boolean":
            least, most = 0, 1
        if not ((found == np.rint(found)) & (least <= found) & (found <= most)).all():
            raise GraphError(f"{said} of type {kind} takes whole numbers from {least} to {most}")
    return Input(node, time_s, found)


def sampled(inputs: Mapping[Node, tuple[str, Given]], time_s: np.ndarray) -> list[Input]:
    """Return inputs over time with functions sampled.

    Args:
        inputs: by component and variable: their types, and what is given.
        time_s: (n,) times in s at which functions are sampled.

    Raises:
        GraphError: a function returns values that are not finite, out of range, or of another
            shape.
    """
    return [
        check_values(node, kind, *((time_s, given(time_s)) if callable(given) else given))
        for node, (kind, given) in inputs.items()
    ]


def read_inputs(
    path: Path,
    fmus: Mapping[str, Fmu],
    entries: Sequence[Connection],
    units: Mapping[str, UnitUse] = {},
) -> dict[str, Series]:
    """Return inputs over time by "component.variable" from a file.

    Args:
        path: .csv or .parquet: a column "time" in s, and one per input, named "component.variable"
            or as a connector of the system, then optionally a unit as in "motor.u [mV]".
        fmus: of the components.
        entries: from connectors of the system to inputs.
        units: of connectors of the system that have one.

    Raises:
        GraphError: it cannot be read, or a column is no input or in another unit.
    """
    require_file(path, _TABLE)
    with parsing(path, _TABLE):
        read = parquet.read_table if path.suffix == ".parquet" else csv.read_csv
        columns = _columns(read(path))
    if "time" not in columns:
        raise GraphError(f"{path}: it has no column time; {_TABLE.fix}")
    time_s = columns.pop("time")
    found: dict[str, Series] = {}
    for column, values in columns.items():
        name, unit = column.strip(), ""
        if (parts := _UNIT.fullmatch(name)) and not _is_known(fmus, entries, name):
            name, unit = parts.groups()
        ends = [entry for entry in entries if entry.source == name]
        for end in ends or [Connection(name, name)]:
            component, variable = find(fmus, end.target)
            fmu = fmus[component]
            own = unit_use(fmu.variables[variable], fmu.description)
            factor, offset = end.factor, end.offset
            if unit:
                own = units.get(name) if ends else own
                if own is None:
                    raise GraphError(f"{path}: column {column}: {name} has no unit; leave it out")
                used = UnitUse(unit, base_unit(unit, fmu.description), own.difference)
                scale, shift = convert(f"{path}: column {column}", used, own)
                factor, offset = factor * scale, factor * shift + offset
            if end.target in found:
                raise GraphError(f"{path}: two columns give {end.target}; remove one")
            found[end.target] = time_s, factor * values + offset
    return found


def _is_known(fmus: Mapping[str, Fmu], entries: Sequence[Connection], name: str) -> bool:
    """Return whether a column's whole header is an input, brackets and all."""
    try:
        return any(entry.source == name for entry in entries) or bool(find(fmus, name))
    except GraphError:
        return False


def _columns(table: Any) -> dict[str, np.ndarray]:
    """Values of a table's columns by name; one that is no numbers is refused."""
    found: dict[str, np.ndarray] = {}
    for name in table.column_names:
        if name in found:
            raise ValueError(f"there are two columns {name}")
        try:
            found[name] = table[name].cast("float64").to_numpy()
        except (ArrowInvalid, ArrowNotImplementedError) as error:
            raise ValueError(f"column {name} has values that are not numbers") from error
    return found

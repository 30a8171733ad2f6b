"""Parameter sets of SSP: values by hierarchical names, from .ssv and .ssm files or from within."""

from collections.abc import Callable, Iterator
from typing import NamedTuple
from xml.etree.ElementTree import Element

from fmpy.model_description import BaseUnit, ModelDescription, ModelVariable

from cosim.fmi.units import EXPONENTS, base_unit, conversion, unit_of
from cosim.system.graph import GraphError

_SET = "application/x-ssp-parameter-set"
_MAPPING = "application/x-ssp-parameter-mapping"
_SCALED = ("Real", "Float64", "Float32")


class Value(NamedTuple):
    """A value of a parameter set.

    Attributes:
        text: as it stands in the file.
        kind: name of its element, such as Real.
        unit: name and definition, None if it has none.
    """

    text: str
    kind: str
    unit: tuple[str, BaseUnit | None] | None


def children(element: Element, *path: str) -> Iterator[Element]:
    """Elements behind a path of local names, whichever version's namespace they are of."""
    yield from element.iterfind("/".join(f"{{*}}{name}" for name in path))


def local_name(element: Element) -> str:
    """Name of an element without its namespace."""
    return element.tag.rpartition("}")[2]


def linear(element: Element, said: str) -> tuple[float, float]:
    """Factor and offset of the transformation in a connection or mapping entry.

    Raises:
        GraphError: it has one of another kind.
    """
    for child in element:
        name = local_name(child)
        if name == "LinearTransformation":
            return float(child.get("factor", "1")), float(child.get("offset", "0"))
        if name.endswith("Transformation"):
            raise GraphError(f"{said}: a {name} is not supported; use a LinearTransformation")
    return 1.0, 0.0


def bound_values(element: Element, read: Callable[[str], Element], said: str) -> dict[str, Value]:
    """Values of an element's parameter bindings by name; later bindings go first.

    Args:
        element: a component or system of an SSD file.
        read: gives the root of a file by the name that the SSD file has for it.
        said: what the element is called in messages.

    Raises:
        GraphError: a binding is of a kind that is not supported.
    """
    found: dict[str, Value] = {}
    for binding in children(element, "ParameterBindings", "ParameterBinding"):
        kind = binding.get("type", _SET)
        if kind != _SET or binding.get("sourceBase", "SSD") != "SSD":
            raise GraphError(f"{said}: parameters of type {kind} are not supported; use {_SET}")
        source = binding.get("source")
        roots = [read(source)] if source else children(binding, "ParameterValues", "ParameterSet")
        values = {
            f"{binding.get('prefix', '')}{name}": value
            for root in roots
            for name, value in _values(root)
        }
        for mapping in children(binding, "ParameterMapping"):
            values = _mapped(mapping, values, read, said)
        found.update(values)
    return found


def _values(root: Element) -> Iterator[tuple[str, Value]]:
    units = {}
    for unit in children(root, "Units", "Unit"):
        for base in children(unit, "BaseUnit"):
            factor, offset = float(base.get("factor", "1")), float(base.get("offset", "0"))
            exponents = {e: int(base.get(e, "0")) for e in EXPONENTS}
            units[unit.get("name")] = BaseUnit(**exponents, factor=factor, offset=offset)
    for parameter in children(root, "Parameters", "Parameter"):
        for typed in parameter:
            text = typed.get("value")
            if text is not None:
                name = typed.get("unit")
                unit = (name, units.get(name)) if name else None
                yield parameter.get("name", ""), Value(text, local_name(typed), unit)


def _mapped(
    mapping: Element, values: dict[str, Value], read: Callable[[str], Element], said: str
) -> dict[str, Value]:
    """Values by the names that a mapping gives them; those it does not name keep theirs."""
    kind, source = mapping.get("type", _MAPPING), mapping.get("source")
    if kind != _MAPPING:
        raise GraphError(f"{said}: a mapping of type {kind} is not supported; use {_MAPPING}")
    roots = [read(source)] if source else list(children(mapping, "ParameterMapping"))
    entries = [entry for root in roots for entry in children(root, "MappingEntry")]
    taken = {entry.get("source") for entry in entries}
    found = {name: value for name, value in values.items() if name not in taken}
    for entry in entries:
        value = values.get(entry.get("source", ""))
        if value is not None:
            factor, offset = linear(entry, f"{said}, mapping of {entry.get('source')}")
            if (factor, offset) != (1.0, 0.0):
                value = value._replace(text=_scaled(value.text, factor, offset))
            found[entry.get("target", "")] = value
    return found


def _scaled(text: str, factor: float, offset: float) -> str:
    return " ".join(repr(factor * float(each) + offset) for each in text.split())


def start_text(
    value: Value, variable: ModelVariable, description: ModelDescription, said: str
) -> str:
    """A value as text of a variable's type, in its unit.

    Raises:
        GraphError: the units do not match.
    """
    unit = unit_of(variable)
    if value.unit is None or unit is None or value.kind not in _SCALED:
        return value.text
    known = value.unit[1] or base_unit(value.unit[0], description)
    found = conversion((value.unit[0], known), (unit, base_unit(unit, description)))
    if found is None:
        raise GraphError(
            f"{said}: value of '{variable.name}' in {value.unit[0]}, which does not match "
            f"{unit}; give it in {unit}"
        )
    return value.text if found == (1.0, 0.0) else _scaled(value.text, *found)

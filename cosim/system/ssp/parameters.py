"""Parameter sets of SSP: values by hierarchical names, from .ssv and .ssm files or from within."""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple
from xml.etree.ElementTree import Element

from fmpy.model_description import BaseUnit, ModelDescription, ModelVariable

from cosim.fmi.units import EXPONENTS, UnitUse, base_unit, unit_use
from cosim.system.graph import GraphError, convert
from cosim.system.ssp.schema import local_name

_SET = "application/x-ssp-parameter-set"
_MAPPING = "application/x-ssp-parameter-mapping"
_SCALED = ("Real", "Float64", "Float32")
_TRUE = ("true", "1")


class Value(NamedTuple):
    """A value of a parameter set.

    Attributes:
        text: as it stands in the file; a tuple of the elements of an array of texts.
        kind: name of its element, such as Real.
        unit: of the value, None if it has none.
        level: of systems in systems at which it is given, from 0 outside; the outermost one counts.
    """

    text: str | tuple[str, ...]
    kind: str
    unit: UnitUse | None
    level: int = 0

    def scaled(self, factor: float, offset: float, said: str) -> "Value":
        """Return factor · value + offset; raises GraphError if the value is not a number."""
        if (factor, offset) == (1.0, 0.0):
            return self
        if self.kind not in _SCALED or not isinstance(self.text, str):
            raise GraphError(
                f"{said}: a value of type {self.kind} cannot be scaled; remove the transformation"
            )
        numbers = (factor * float(each) + offset for each in self.text.split())
        return self._replace(text=" ".join(map(repr, numbers)))


def children(element: Element, *path: str) -> Iterator[Element]:
    """Elements behind a path of local names, whichever version's namespace they are of."""
    yield from element.iterfind("/".join(f"{{*}}{name}" for name in path))


def is_true(element: Element, attribute: str) -> bool:
    """Return whether an attribute of type Boolean is true; by default it is not."""
    return element.get(attribute, "false") in _TRUE


def linear(element: Element, said: str) -> tuple[float, float]:
    """Factor and offset of the transformation in a connection or mapping entry.

    Raises:
        GraphError: they are not finite.
    """
    for child in children(element, "LinearTransformation"):
        found = float(child.get("factor", "1")), float(child.get("offset", "0"))
        if not all(map(math.isfinite, found)):
            raise GraphError(f"{said}: factor {found[0]:g} and offset {found[1]:g} must be finite")
        return found
    return 1.0, 0.0


def units_of(root: Element) -> dict[str, UnitUse]:
    """Return the units that a file defines, by name."""
    found = {}
    for unit in children(root, "Units", "Unit"):
        for base in children(unit, "BaseUnit"):
            factor, offset = float(base.get("factor", "1")), float(base.get("offset", "0"))
            exponents = {e: int(base.get(e, "0")) for e in EXPONENTS}
            name = unit.get("name", "")
            found[name] = UnitUse(name, BaseUnit(**exponents, factor=factor, offset=offset))
    return found


def bound_values(
    element: Element, read: Callable[[str], Element], said: str, level: int
) -> dict[str, Value]:
    """Values of an element's parameter bindings by name; later bindings go first.

    Args:
        element: a component or system of an SSD file.
        read: gives the root of a file by the name that the SSD file has for it.
        said: what the element is called in messages.
        level: of the element, from 0 outside.

    Raises:
        GraphError: a binding is of a kind that is not supported.
    """
    found: dict[str, Value] = {}
    for binding in children(element, "ParameterBindings", "ParameterBinding"):
        kind = binding.get("type", _SET)
        if kind != _SET:
            raise GraphError(f"{said}: parameters of type {kind} are not supported; use {_SET}")
        _require_own_base(binding, said)
        source = binding.get("source")
        roots = [read(source)] if source else children(binding, "ParameterValues", "ParameterSet")
        values = {
            f"{binding.get('prefix', '')}{name}": value
            for root in roots
            for name, value in _values(root)
        }
        for mapping in children(binding, "ParameterMapping"):
            values = _mapped(mapping, values, read, said)
        found.update({name: value._replace(level=level) for name, value in values.items()})
    return found


def _require_own_base(element: Element, said: str) -> None:
    if (base := element.get("sourceBase", "SSD")) != "SSD":
        raise GraphError(f"{said}: sourceBase {base} is not supported; put the file into the .ssp")


def _values(root: Element) -> Iterator[tuple[str, Value]]:
    units = units_of(root)
    for parameter in children(root, "Parameters", "Parameter"):
        for typed in parameter:
            items = tuple(item.get("value", "") for item in children(typed, "Value"))
            text = items or typed.get("value")
            if text is not None:
                name = typed.get("unit")
                unit = units.get(name, UnitUse(name, None)) if name else None
                yield parameter.get("name", ""), Value(text, local_name(typed), unit)


def _mapped(
    mapping: Element, values: dict[str, Value], read: Callable[[str], Element], said: str
) -> dict[str, Value]:
    """Values by the names that a mapping gives them; those it does not name are not applied."""
    kind, source = mapping.get("type", _MAPPING), mapping.get("source")
    if kind != _MAPPING:
        raise GraphError(f"{said}: a mapping of type {kind} is not supported; use {_MAPPING}")
    _require_own_base(mapping, said)
    roots = [read(source)] if source else list(children(mapping, "ParameterMapping"))
    found = {}
    for entry in (entry for root in roots for entry in children(root, "MappingEntry")):
        value = values.get(entry.get("source", ""))
        if value is not None:
            if is_true(entry, "suppressUnitConversion"):
                value = value._replace(unit=None)
            where = f"{said}, mapping of {entry.get('source')}"
            found[entry.get("target", "")] = value.scaled(*linear(entry, where), where)
    return found


def start_value(
    value: Value, variable: ModelVariable, description: ModelDescription, said: str
) -> str | tuple[str, ...]:
    """Return a value as text of a variable's type, in its unit.

    Raises:
        GraphError: the units do not match.
    """
    unit = unit_use(variable, description)
    if value.unit is None or unit is None or value.kind not in _SCALED:
        return value.text
    given = value.unit._replace(base=value.unit.base or base_unit(value.unit.name, description))
    where = f"{said}: value of '{variable.name}'"
    return value.scaled(*convert(where, given, unit), where).text

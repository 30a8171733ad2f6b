"""Units of FMU variables, by their definitions in SI base units, with any names."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from fmpy.model_description import BaseUnit, ModelDescription, ModelVariable

EXPONENTS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
_DIMENSIONLESS = ("", "1", "-")  # names that many exporters do not define
_COMPARED = len(EXPONENTS) - 1  # all but rad, which is 1


class UnitUse(NamedTuple):
    """The unit in which values are.

    Attributes:
        name: of the unit.
        base: its definition in SI base units, None if it has none.
        difference: whether values are differences, so that offsets do not count; None if unknown.
    """

    name: str
    base: BaseUnit | None
    difference: bool | None = None


def unit_of(variable: ModelVariable) -> str | None:
    """Name of a variable's unit, its own or its type's; None if it has none."""
    return variable.unit or (variable.declaredType and variable.declaredType.unit) or None


def unit_use(variable: ModelVariable, description: ModelDescription) -> UnitUse | None:
    """Return the unit of a variable, None if it has none."""
    name = unit_of(variable)
    if name is None:
        return None
    relative = variable.relativeQuantity
    if relative is None and variable.declaredType:
        relative = variable.declaredType.relativeQuantity
    return UnitUse(name, base_unit(name, description), bool(relative))


def base_unit(name: str, description: ModelDescription) -> BaseUnit | None:
    """Definition of a unit in SI base units: value in them = factor · value + offset."""
    defined = (u.baseUnit for u in description.unitDefinitions if u.name == name)
    return next(defined, BaseUnit() if name in _DIMENSIONLESS else None)


def exponents(base: BaseUnit | Mapping[str, int]) -> tuple[int, ...]:
    """Exponents of the SI base units and rad."""
    values: Any = base.get if isinstance(base, Mapping) else lambda e, _: getattr(base, e)
    return tuple(int(values(exponent, 0)) for exponent in EXPONENTS)


def conversion(source: UnitUse, target: UnitUse) -> tuple[float, float] | None:
    """Return factor and offset from values in one unit to values in another; None if none are.

    Units without a definition are the same if their names are. An angle in rad is a number.
    """
    base, other = source.base, target.base
    if source.name == target.name and (base is None or other is None):
        return 1.0, 0.0
    if base is None or other is None:
        return None
    if exponents(base)[:_COMPARED] != exponents(other)[:_COMPARED]:
        return None
    offset = (base.offset - other.offset) / other.factor
    differences = {source.difference, target.difference}
    if (base.offset or other.offset) and differences == {True, False}:
        return None
    return base.factor / other.factor, 0.0 if True in differences else offset

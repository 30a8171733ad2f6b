"""Units of FMU variables: what their definitions in SI base units say, whatever their names."""

from collections.abc import Mapping
from typing import Any

from fmpy.model_description import BaseUnit, ModelDescription, ModelVariable

EXPONENTS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


def unit_of(variable: ModelVariable) -> str | None:
    """Name of a variable's unit, its own or its type's; None if it has none."""
    return variable.unit or (variable.declaredType and variable.declaredType.unit) or None


def base_unit(name: str, description: ModelDescription) -> BaseUnit | None:
    """Definition of a unit in SI base units: value in them = factor · value + offset."""
    return next((u.baseUnit for u in description.unitDefinitions if u.name == name), None)


def exponents(base: BaseUnit | Mapping[str, int]) -> tuple[int, ...]:
    """Exponents of the SI base units and rad."""
    values: Any = base.get if isinstance(base, Mapping) else lambda e, _: getattr(base, e)
    return tuple(int(values(exponent, 0)) for exponent in EXPONENTS)


def conversion(
    source: tuple[str, BaseUnit | None], target: tuple[str, BaseUnit | None]
) -> tuple[float, float] | None:
    """Factor and offset from values in one unit to values in another; None if there are none.

    Args:
        source: name and definition.
        target: likewise. Units without a definition are the same if their names are.
    """
    (name, base), (other, other_base) = source, target
    if name == other and (base is None or other_base is None):
        return 1.0, 0.0
    if base is None or other_base is None or exponents(base) != exponents(other_base):
        return None
    return base.factor / other_base.factor, (base.offset - other_base.offset) / other_base.factor

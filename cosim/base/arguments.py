"""Arguments of the Python API, converted to the types that records declare, or refused by name."""

from collections.abc import Collection, Iterable, Mapping
from functools import cache
from pathlib import Path, PurePath
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import msgspec
import numpy as np

from cosim.base.errors import UserError, shorten

MAX_SEED = 2**63  # recordings have integers of 64 bits


class ConfigError(UserError, ValueError):
    """Invalid parameters or arguments; the message names the argument and how to fix it."""


def validate_argument(name: str, value: Any, kind: Any) -> Any:
    """Return an argument as the type that it must have.

    NumPy scalars and arrays become numbers and lists, lists become tuples, strings paths, and dicts
    records; a string becomes a tuple of one string, and a dict one of pairs where one is expected.

    Args:
        name: of the argument, for messages.
        value: as given.
        kind: type, as msgspec takes it, or with paths.

    Raises:
        ConfigError: it names the argument, its value and what is expected.
    """
    plain = to_plain(name, value)
    if isinstance(plain, PurePath) and kind is str:
        plain = str(plain)
    bare = get_args(kind)[0] if get_origin(kind) is Annotated else kind
    if get_origin(bare) is tuple and isinstance(plain, str | dict):
        plain = (plain,) if isinstance(plain, str) else list(plain.items())
    try:
        return msgspec.convert(plain, kind, dec_hook=_path)
    except msgspec.ValidationError as problem:
        if isinstance(problem.__cause__, UserError):  # of a record's own validation
            raise problem.__cause__ from None
        if known := _choices(kind):
            raise ConfigError(unknown(name, value, known)) from None
        reason = str(problem).replace("`", "").replace("null", "None")
        raise ConfigError(
            f"{name} = {shorten(value)} is invalid: {reason[0].lower()}{reason[1:]}"
        ) from None


def validate_seed(seed: Any) -> int:
    """Return a seed as an int from 0 to 2**63 - 1; raises ConfigError if it is none."""
    seed = validate_argument("seed", seed, int)
    if not 0 <= seed < MAX_SEED:
        raise ConfigError(f"seed = {seed} must not be negative, and below 2**63")
    return seed


def validate_fields(record: Any, but: Collection[str] = ()) -> None:
    """Convert the fields of a frozen record in place, all but some; see `validate_argument`."""
    struct = isinstance(record, msgspec.Struct)
    put = msgspec.structs.force_setattr if struct else object.__setattr__
    for name, kind in _hints(type(record)).items():
        if name not in but:
            put(record, name, validate_argument(name, getattr(record, name), kind))


def require_one_of(name: str, value: str, known: Collection[str]) -> None:
    """Refuse a value that is not among the known ones."""
    if value not in known:
        raise ConfigError(unknown(name, value, known))


def validate_unique(name: str, pairs: Iterable[tuple[str, float]]) -> dict[str, float]:
    """Return pairs of names and numbers as a dict; raises ConfigError if a name is there twice."""
    found: dict[str, float] = {}
    for key, value in pairs:
        if key in found:
            raise ConfigError(f"{name} gives {key} twice; leave one out")
        found[key] = value
    return found


def unknown(name: str, value: Any, known: Collection[str]) -> str:
    """Return the message that refuses a value which is not among the known ones."""
    return f"{name} = {shorten(value)} is unknown; choose one of {', '.join(known)}"


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


def to_plain(name: str, value: Any) -> Any:
    """Return an argument with Python's numbers and lists in place of those of NumPy.

    Raises:
        ConfigError: a value of an array is masked.
    """
    if isinstance(value, np.generic | np.ndarray):
        if np.ma.is_masked(value):
            raise ConfigError(f"{name} = {shorten(value)} has a masked value; leave it out")
        return value.tolist()
    if isinstance(value, Mapping):
        parts = value.items()
        return {to_plain(name, k): to_plain(name, v) for k, v in parts}
    if isinstance(value, list):
        return [to_plain(name, v) for v in value]
    if isinstance(value, tuple):
        return tuple(to_plain(name, v) for v in value)
    return value


def _path(kind: Any, value: Any) -> Any:
    if kind is Path and isinstance(value, str | PurePath):
        return Path(value)
    raise ValueError(f"Expected {kind.__name__}, got {type(value).__name__}")


def _choices(kind: Any) -> tuple[str, ...]:
    """The values of the Literal in a type; none where there is no Literal."""
    if get_origin(kind) is Literal:
        return get_args(kind)
    return next((found for part in get_args(kind) if (found := _choices(part))), ())


def numbers(values: Any, shape: tuple[int, ...], kinds: str = "fiu") -> np.ndarray | None:
    """Return what a user gave as float64, or whole numbers as int64; None if it is anything else.

    Args:
        values: an array, or anything that makes one.
        shape: that it must have.
        kinds: of numbers (`numpy.dtype.kind`) that are allowed; "iu" for whole ones alone.
    """
    try:
        array = np.asarray(values)
    except ValueError:  # rows of several lengths
        return None
    fits = array.shape == shape and array.dtype.kind in kinds and np.isfinite(array).all()
    return array.astype(np.int64 if kinds == "iu" else np.float64, copy=False) if fits else None

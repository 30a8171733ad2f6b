"""Arguments of the Python API, converted to the types that records declare, or refused by name."""

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from difflib import get_close_matches
from functools import cache
from pathlib import Path, PurePath
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec
import numpy as np
from msgspec import Meta

from cosim.base.errors import UserError, shorten

MAX_SEED = 2**63  # recordings have integers of 64 bits


class ConfigError(UserError, ValueError):
    """Invalid parameters or arguments; the message names the argument and how to fix it."""


def validate_argument(name: str, value: Any, kind: Any) -> Any:
    """Return an argument as the type that it must have; all input is validated here.

    NumPy scalars and arrays become numbers and lists, lists become tuples, strings paths, and dicts
    records; a string becomes a tuple of one string, and a dict one of pairs where one is expected.
    """
    plain, kinds = to_plain(name, value), _alternatives([kind])
    if isinstance(plain, PurePath) and kinds == [str]:
        plain = str(plain)
    if [get_origin(k) for k in kinds] == [tuple] and isinstance(plain, str | dict):
        plain = (plain,) if isinstance(plain, str) else list(plain.items())
    try:
        return msgspec.convert(plain, kind, dec_hook=_path)
    except msgspec.ValidationError as problem:
        if isinstance(problem.__cause__, UserError):  # of a record's own validation
            raise problem.__cause__ from None
        raise ConfigError(_fault(name, plain, kind, str(problem))) from None


def _fault(name: str, value: Any, kind: Any, problem: str) -> str:
    """Return the message for what msgspec says, such as "Expected `int` - at `$.sensor[0]`"."""
    reason, _, path = problem.partition(" - at ")
    kinds = [kind]
    for field, index in re.findall(r"\.(\w+)|\[(\d+)\]", path):
        records = [k for k in _alternatives(kinds) if hasattr(k, "_fields")]  # named tuples
        key = records[0]._fields[int(index)] if index and records else field
        kinds = [part for k in _alternatives(kinds) for part in _inside(k, key)]
        name += f".{key}" if key else f"[{index}]"
        value = value[int(index) if index else field]
    name = name.removeprefix(".")
    if "unknown field" in reason:
        fields = [n for k in _alternatives(kinds) for n in getattr(k, "__struct_fields__", ())]
        return unknown(f"{name}.{reason.split('`')[-2]}".removeprefix("."), None, fields)
    if known := next(filter(None, map(_choices, kinds)), ()):
        return unknown(name, value, known)
    reason = reason.replace("`object`", "table").replace("`", "").replace("null", "None")
    ranges = [m for m in _annotations(kinds) if isinstance(m, Meta)]
    limits = [
        f"; give {m.ge:g} to {m.le:g}"
        for m in ranges
        if m.ge is not None and m.le is not None and m.le < MAX_SEED - 1
    ]
    reason = f"{reason[0].lower()}{reason[1:]}{''.join(limits)}"
    return f"{name} = {shorten(value)} is invalid: {reason}" if name else reason


def _alternatives(kinds: Iterable[Any]) -> list[Any]:
    """Return the types that some types may stand for, without what annotates them."""
    found = []
    for kind in kinds:
        if get_origin(kind) is Annotated:
            found += _alternatives(get_args(kind)[:1])
        else:
            union = get_origin(kind) in {Union, UnionType}
            found += _alternatives(get_args(kind)) if union else [kind]
    return found


def _annotations(kinds: Iterable[Any]) -> Iterator[Any]:
    """Yield what annotates types, and those that are joined in a union."""
    for kind in kinds:
        yield from getattr(kind, "__metadata__", ())
        if get_origin(kind) in {Annotated, Union, UnionType}:
            yield from _annotations(get_args(kind))


def _inside(kind: Any, key: str) -> tuple[Any, ...]:
    """Return the types of a field of a record, or of the items of a sequence."""
    if key:
        return (_hints(kind)[key],) if isinstance(kind, type) and key in _hints(kind) else ()
    return tuple(part for part in get_args(kind) if part is not Ellipsis)[:1]


def validate_seed(seed: Any) -> int:
    """Return a seed as an int from 0 to 2**63 - 1; raises ConfigError if it is none."""
    seed = validate_argument("seed", seed, int)
    if not 0 <= seed < MAX_SEED:
        raise ConfigError(f"seed = {seed} must not be negative, and below 2**63")
    return seed


def validate_fields(record: Any, where: str = "", but: Collection[str] = ()) -> None:
    """Convert the fields of a frozen record in place, all but some; see `validate_argument`."""
    struct = isinstance(record, msgspec.Struct)
    put = msgspec.structs.force_setattr if struct else object.__setattr__
    for name, kind in _hints(type(record)).items():
        if name not in but:
            put(record, name, validate_argument(where + name, getattr(record, name), kind))


def require_names(where: str, names: Iterable[str], known: Collection[str]) -> None:
    """Refuse names of fields or options that are not among the known ones."""
    for name in names:
        if name not in known:
            raise ConfigError(unknown(where + name, None, known))


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
    """Return the message that refuses a value, or for None a name, that is none of the known."""
    wrong = name.rpartition(".")[2] if value is None else str(value)
    near = [f" (did you mean {like}?)" for like in get_close_matches(wrong, known, 1)]
    name = name if value is None else f"{name} = {shorten(value)}"
    return f"{name} is unknown; choose one of {', '.join(known)}{''.join(near)}"


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


def to_plain(name: str, value: Any) -> Any:
    """Return an argument with Python's numbers and lists in place of those of NumPy."""
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
        kinds: of numbers (`numpy.dtype.kind`) that are allowed; "iu" for whole ones alone.
    """
    try:
        array = np.asarray(values)
    except ValueError:  # rows of several lengths
        return None
    fits = array.shape == shape and array.dtype.kind in kinds and np.isfinite(array).all()
    return array.astype(np.int64 if kinds == "iu" else np.float64, copy=False) if fits else None

"""Arguments of the Python API, converted to the types that records declare, or refused by name."""

import importlib
import re
import sys
from collections.abc import Collection, Iterable, Mapping
from difflib import get_close_matches
from functools import cache, partial
from pathlib import Path, PurePath
from typing import Any, get_type_hints

import msgspec
import numpy as np
from msgspec import inspect

from cosim.base.errors import UserError, shorten

MAX_SEED = 2**63  # recordings have integers of 64 bits


class ConfigError(UserError, ValueError):
    """Invalid parameters or arguments; the message names the argument and how to fix it."""


def validate_argument(name: str, value: Any, kind: Any) -> Any:
    """Return an argument as the type that it must have; all input is validated here.

    NumPy scalars and arrays become numbers and lists, lists become tuples, strings paths, and dicts
    records; a string becomes a tuple of one string, and a dict one of pairs where one is expected.
    """
    plain = to_plain(name, value)
    if isinstance(plain, str | dict | PurePath):
        match _alternatives(_type_of(kind)), plain:
            case (inspect.StrType(),), PurePath():
                plain = str(plain)
            case (inspect.TupleType() | inspect.VarTupleType(),), str():
                plain = (plain,)
            case (inspect.TupleType() | inspect.VarTupleType(),), dict():
                plain = list(plain.items())
    try:
        return msgspec.convert(plain, kind, dec_hook=_path)
    except msgspec.ValidationError as problem:
        if isinstance(problem.__cause__, UserError):  # of a record's own validation
            raise problem.__cause__ from None
        raise _fault(name, plain, _type_of(kind), str(problem)) from None


def _fault(name: str, value: Any, kind: inspect.Type, problem: str) -> ConfigError:
    """Return the error for what msgspec says, such as "Expected `int` - at `$.sensor[0]`"."""
    reason, _, path = problem.partition(" - at ")
    kinds: Any = _alternatives(kind)
    for key, index in re.findall(r"\.(\w+)|\[(\d+)\]", path):
        fields = {f.name: f.type for k in kinds for f in getattr(k, "fields", ())}
        value = value[int(index) if index else key]
        field = key or (fields and [*fields][int(index)])  # records may be tuples with names
        of_kinds = [getattr(k, "item_types", [getattr(k, "item_type", None)]) for k in kinds]
        items = [item for items in of_kinds for item in items]
        inside = [fields[field]] if field else [*filter(None, items)][:1]
        kinds = [alternative for item in inside for alternative in _alternatives(item)]
        name += f".{field}" if field else f"[{index}]"
    name = name.removeprefix(".")
    if "unknown field" in reason:
        fields = [f.name for k in kinds for f in getattr(k, "fields", ())]
        return unknown(f"{name}.{reason.split('`')[-2]}".removeprefix("."), None, fields)
    for choices in (k.values for k in kinds if isinstance(k, inspect.LiteralType)):
        return unknown(name, str(value), [str(choice) for choice in choices])
    reason = reason.replace("`object`", "table").replace("`", "").replace("null", "None")
    limits = [
        f"; give {k.ge:g} to {k.le:g}"
        for k in kinds
        if isinstance(k, inspect.IntType | inspect.FloatType)
        and k.ge is not None
        and k.le is not None
        and k.le < MAX_SEED - 1
    ]
    reason = f"{reason[0].lower()}{reason[1:]}{''.join(limits)}"
    return ConfigError(f"{name} = {shorten(value)} is invalid: {reason}" if name else reason)


_type_of = cache(inspect.type_info)


def _alternatives(kind: inspect.Type) -> tuple[inspect.Type, ...]:
    """Return the types that a type stands for."""
    kind = kind.type if isinstance(kind, inspect.Metadata) else kind
    return kind.types if isinstance(kind, inspect.UnionType) else (kind,)


def validate_fields(record: Any, where: str = "", but: Collection[str] = ()) -> None:
    """Convert the fields of a frozen record in place, all but some; see `validate_argument`."""
    struct = isinstance(record, msgspec.Struct)
    put = msgspec.structs.force_setattr if struct else object.__setattr__
    for name, kind in _hints(type(record)).items():
        if name not in but:
            put(record, name, validate_argument(where + name, getattr(record, name), kind))


_hints = cache(partial(get_type_hints, include_extras=True))


def require_names(where: str, names: Iterable[str], known: Collection[str]) -> None:
    """Refuse names of fields or options that are not among the known ones."""
    for name in names:
        if name not in known:
            raise unknown(where + name, None, known)


def require_one_of(name: str, value: str, known: Collection[str]) -> None:
    """Refuse a value that is not among the known ones."""
    if value not in known:
        raise unknown(name, value, known)


def unknown(name: str, value: str | None, known: Collection[str]) -> ConfigError:
    """Return the error for a value, or for None the name itself, that is none of the known ones."""
    wrong = re.split(r"[. ]", name)[-1] if value is None else value
    near = [f" (did you mean {like}?)" for like in get_close_matches(wrong, known, 1)]
    name = name if value is None else f"{name} = {shorten(value)}"
    return ConfigError(f"{name} is unknown; choose one of {', '.join(known)}{''.join(near)}")


def validate_unique(name: str, pairs: Iterable[tuple[str, float]]) -> dict[str, float]:
    """Return pairs of names and numbers as a dict; raises ConfigError if a name is there twice."""
    found: dict[str, float] = {}
    for key, value in pairs:
        if key in found:
            raise ConfigError(f"{name} gives {key} twice; leave one out")
        found[key] = value
    return found


def to_plain(name: str, value: Any) -> Any:
    """Return an argument with Python's numbers and lists in place of those of NumPy."""
    if isinstance(value, np.generic | np.ndarray):
        if np.ma.is_masked(value):
            raise ConfigError(f"{name} = {shorten(value)} has a masked value; leave it out")
        return value.tolist()
    if isinstance(value, Mapping):
        return {to_plain(name, k): to_plain(name, v) for k, v in value.items()}
    if isinstance(value, list | tuple):  # records, too
        plain = (to_plain(name, v) for v in value)
        return list(plain) if isinstance(value, list) else tuple(plain)
    return value


def _path(kind: Any, value: Any) -> Any:
    if kind is Path and isinstance(value, str | PurePath):
        return Path(value)
    raise ValueError(f"Expected {kind.__name__}, got {type(value).__name__}")


def numbers(
    values: Any, shape: tuple[int, ...], kinds: str = "fiu", *, finite: bool = True
) -> np.ndarray | None:
    """Return what a user gave as float64, or whole numbers (kinds "iu") as int64; else None.

    Masked numbers are none, nor are those that are not finite, unless `finite` is False.
    """
    try:
        array = np.asarray(values)
    except Exception:  # rows of several lengths, or whatever an object of a user does
        return None
    fits = array.shape == shape and array.dtype.kind in kinds and not np.ma.is_masked(values)
    fits = fits and (not finite or bool(np.isfinite(array).all()))
    return array.astype(np.int64 if kinds == "iu" else np.float64, copy=False) if fits else None


def imported(what: str, name: str, kind: str) -> Any:
    """Return the object "module:Name" of this folder or an installed module, or one of its class.

    `what` it is, and the `kind` of objects that are expected, are named where that fails.
    """
    module, _, attribute = name.partition(":")
    if str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))
    try:
        found = getattr(importlib.import_module(module), attribute)
        return found() if isinstance(found, type) else found
    except (Exception, SystemExit) as error:  # whatever a user's module does
        raise ConfigError(
            f"{what} = {name!r} cannot be imported ({error!r}); name MODULE:NAME of {kind}, in a "
            "module of this folder or an installed one"
        ) from error

"""The memory of a WebAssembly module before its first call: a record of numbers and arrays."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

_LINE = 64  # bytes at whose multiples arrays begin


class Image(NamedTuple):
    """Bytes for memory at an address that is a multiple of 64, and what is where in them."""

    content: bytes
    # "record": offset of the record's slots; "pointers": offsets of the numbers to which the
    # address is added; "arrays": offset, type and shape by name; "numbers": offset by name, and
    # whether it is whole
    layout: dict[str, Any]


def image_of(record: tuple[Any, ...], **more: np.ndarray) -> Image:
    """Return the memory for calls of kernels that take a record, with more arrays behind it.

    The record's numbers stand in slots of 8 bytes, and arrays as numba passes them. What is one
    array in Python is one in memory. What is in a record has the names of both with a dot between
    them.
    """
    places: dict[int, int] = {}  # of arrays, by their identity
    content, slots = bytearray(), []
    layout: dict[str, Any] = {"pointers": [], "arrays": {}, "numbers": {}}

    def put(raw: bytes) -> int:
        content.extend(bytes(-len(content) % _LINE) + raw)
        return len(content) - len(raw)

    def put_array(name: str, array: np.ndarray) -> int:
        if array.ndim > 1 and array.flags.fnc:
            raise TypeError(f"{name} is an array in Fortran's order; copy it into C's")
        if id(array) not in places:
            places[id(array)] = put(array.tobytes())
        layout["arrays"][name] = [places[id(array)], array.dtype.name, array.shape]
        return places[id(array)]

    for name, leaf in _leaves("", record):
        if isinstance(leaf, np.ndarray):
            steps = np.cumprod((leaf.itemsize, *leaf.shape[:0:-1]))[::-1].tolist()
            layout["pointers"].append(8 * (len(slots) + 4))
            slots += [0, 0, leaf.size, leaf.itemsize, put_array(name, leaf), *leaf.shape, *steps]
        else:
            whole = not isinstance(leaf, float)
            layout["numbers"][name] = [8 * len(slots), whole]
            slots.append(leaf if whole else int(np.float64(leaf).view(np.int64)))
    for name, array in more.items():
        put_array(name, array)
    layout["record"] = begin = put(np.array(slots, dtype=np.int64).tobytes())
    layout["pointers"] = [begin + at for at in layout["pointers"]]
    layout["numbers"] = {
        name: [begin + at, whole] for name, (at, whole) in layout["numbers"].items()
    }
    return Image(bytes(content), layout)


def _leaves(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Arrays and numbers of a record in numba's order, with their names."""
    if isinstance(value, tuple):
        fields = getattr(value, "_fields", range(len(value)))
        for field, part in zip(fields, value, strict=True):
            yield from _leaves(f"{name}.{field}" if name else str(field), part)
    else:
        yield name, value if isinstance(value, (np.ndarray, float)) else int(value or 0)

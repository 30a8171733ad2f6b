"""Serialised states of an array of motors: damaged, foreign and impossible ones are refused."""

import struct
from typing import Any

import numpy as np
import pytest

OK, ERROR = 0, 3
MOST = 65536


def refused(motors: Any, status: int, *words: str) -> None:
    assert status == ERROR
    assert all(word in motors.messages[-1] for word in words), motors.messages[-1]


def test_damaged_states_are_refused(array):
    motors = array(3).start(omega_des=700.0)
    assert motors.do_step(0.0, 0.1) == OK
    saved = motors.save()
    for bit in range(0, 8 * len(saved), 7):
        damaged = bytearray(saved)
        damaged[bit // 8] ^= 1 << bit % 8
        refused(motors, motors.load(bytes(damaged)), "damaged")
    refused(motors, motors.load(saved[:50]), "50 bytes")
    refused(motors, motors.load(saved + b"\0" * 8), "damaged")
    refused(motors, motors.load(motors.sealed(saved[:-8] + b"\0" * 16)), "out of range")
    other = b"{%c" % (saved[1] ^ 1) + saved[2:]
    refused(motors, motors.load(motors.sealed(other)), "another build")
    assert motors.save() == saved
    assert motors.load(saved) == OK


# Places in a state behind its token, in bytes: see Head in array.c.
TOKEN = 39
FIELDS = {
    "time": (0, "=d", (np.nan, np.inf)), "owed": (8, "=d", (np.nan, 1.1e-11)),
    "stop_time": (16, "=d", (np.nan, -np.inf)), "life_cycle": (24, "=q", (0, 3, 32, 128)),
    "step_size": (32, "=d", (0.0, 1.0, np.nan)),
    "n": (40, "=Q", (0, 1, 2, 4, MOST + 1, 2**64 - 1)), "closed_loop": (48, "=q", (2, -1)),
    "samples": (56, "=Q", (0, MOST + 1, 2**64 - 1)),
    "omega_des of motor 2": (72, "=d", (np.nan, np.inf)),
    "m of motor 1": (64 + 4 * 24, "=d", (-1.0, np.nan)),
    "J of motor 3": (64 + 7 * 24 + 16, "=d", (0.0, np.nan)),
    "omega of motor 3": (64 + 19 * 24 + 16, "=d", (np.nan, np.inf)),
}  # fmt: skip


@pytest.mark.parametrize("field", FIELDS)
def test_values_out_of_range_are_refused(array, field):
    motors, (place, kind, values) = array(3).start(omega_des=700.0), FIELDS[field]
    saved = motors.save()
    for value in values:
        content = bytearray(saved)
        struct.pack_into(kind, content, TOKEN + place, value)
        refused(motors, motors.load(motors.sealed(bytes(content))), "out of range")
    assert motors.save() == saved

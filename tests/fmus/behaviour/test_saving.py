"""Serialised states: damaged, foreign and impossible ones are refused."""

import math
import struct

import numpy as np
import pytest

OK, ERROR = 0, 3
DOUBLE, INTEGER = "=d", "=i"
# Places in a serialised state, in bytes from its end.
FIELD = {
    "closed_loop": (96, INTEGER), "solver": (92, INTEGER), "theta": (88, DOUBLE),
    "omega": (80, DOUBLE), "integral": (72, DOUBLE), "modes_held": (56, INTEGER),
    "friction": (52, INTEGER), "saturation": (48, INTEGER), "jumped": (44, INTEGER),
    "time": (40, DOUBLE), "owed": (32, DOUBLE), "stop_time": (24, DOUBLE),
    "life_cycle": (16, INTEGER), "model_exchange": (12, INTEGER),
}  # fmt: skip
LEAST_INTEGER = -(2**31)


def with_field(motor, saved: bytes, name: str, value: float) -> bytes:
    """The state with one value replaced and the checksum put right."""
    content, (place, kind) = bytearray(saved), FIELD[name]
    struct.pack_into(kind, content, len(content) - place, value)
    return motor.sealed(bytes(content))


@pytest.fixture(params=[False, True], ids=["co-simulation", "exchange"])
def motor(request, instance, fmi):
    motor = instance(fmi, request.param).start(omega_des=700.0)
    if not request.param:
        assert motor.do_step(0.0, 0.1) == OK
    return motor


def refuse(motor, content: bytes, word: str) -> None:
    before, said = motor.save(), len(motor.messages)
    assert motor.load(content) == ERROR
    assert len(motor.messages) == said + 1
    assert word in motor.messages[-1]
    assert motor.save() == before


def test_every_flipped_bit_is_refused(motor):
    saved = motor.save()
    for bit in range(8 * len(saved)):
        damaged = bytearray(saved)
        damaged[bit // 8] ^= 1 << bit % 8
        refuse(motor, bytes(damaged), "the bytes are a damaged state")
    assert motor.load(saved) == OK


def test_wrong_sizes_are_refused(motor):
    saved = motor.save()
    for content in (b"", saved[:-1], saved + b"\0", saved + saved):
        refuse(motor, content, f"{len(content)} bytes, but a state has {len(saved)}")


def test_states_of_another_build_are_refused(motor):
    saved = motor.save()
    assert saved.startswith(b"{")
    refuse(motor, motor.sealed(b"{%c" % (saved[1] ^ 1) + saved[2:]), "another build")


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("theta", (math.nan, math.inf)),
        ("omega", (math.nan, -math.inf)),
        ("integral", (math.nan, math.inf)),
        ("time", (math.nan, math.inf)),
        ("owed", (math.nan, 1.1e-11, -1.1e-11)),
        ("closed_loop", (-1, 2)),
        ("solver", (0, 3)),
        ("friction", (2, -2, LEAST_INTEGER)),
        ("saturation", (2, -2, LEAST_INTEGER)),
        ("jumped", (2, -1)),
        ("stop_time", (math.nan, -math.inf)),
        ("life_cycle", (0, 3, 64, LEAST_INTEGER)),
        ("model_exchange", (2, -1)),
    ],
)
def test_values_out_of_range_are_refused(motor, name, values):
    saved = motor.save()
    for value in values:
        refuse(motor, with_field(motor, saved, name, value), "out of range")


def test_parameters_out_of_range_are_refused(motor):
    saved = motor.save()
    place = saved.index(struct.pack(DOUBLE, motor.get("J")[0]))
    for value in (0.0, -1e-9, math.nan):
        content = saved[:place] + struct.pack(DOUBLE, value) + saved[place + 8 :]
        refuse(motor, motor.sealed(content), "out of range")


def test_modes_hold_in_model_exchange_only(instance, fmi):
    motor = instance(fmi).start()
    for name in ("modes_held", "friction", "saturation", "jumped"):
        refuse(motor, with_field(motor, motor.save(), name, 1), "out of range")
    motor = instance(fmi, True).start()
    refuse(motor, with_field(motor, motor.save(), "modes_held", 0), "out of range")


def test_other_sound_values_are_accepted(instance, fmi):
    motor = instance(fmi).start()
    for name, value in (("theta", 3.0), ("omega", 200.0), ("time", 5.0), ("owed", -1e-12)):
        assert motor.load(with_field(motor, motor.save(), name, value)) == OK, motor.messages
    assert motor.get("theta", "omega", "time") == [3.0, 200.0, 5.0]
    assert motor.do_step(5.0, 1e-5) == OK


def test_any_content_that_is_accepted_is_harmless(motor):
    saved, generator, accepted = motor.save(), np.random.default_rng(0), 0
    for _ in range(500):
        content = bytearray(saved)
        for _ in range(generator.integers(1, 4)):
            content[generator.integers(40, len(saved) - 8)] = generator.integers(256)
        if motor.load(motor.sealed(bytes(content))) == OK:
            accepted += 1
            time_s = struct.unpack_from(DOUBLE, content, len(content) - FIELD["time"][0])[0]
            motor.do_step(time_s, 1e-4)
            motor.call("Terminate")
    assert 50 < accepted < 450

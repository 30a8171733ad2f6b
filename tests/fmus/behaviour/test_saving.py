"""Serialised states: damaged, foreign and impossible ones are refused, also of an array of one."""

import math
import struct

import pytest

OK, ERROR = 0, 3
NAN, INF = math.nan, math.inf


@pytest.fixture
def motor(instance, kind):
    motor = instance(kind).start(omega_des=700.0)
    assert motor.do_step(0.0, 0.1) == OK
    return motor


def refuse(motor, content: bytes, word: str) -> None:
    before, said = motor.save(), len(motor.messages)
    motor.refused(motor.load(content), word)
    assert len(motor.messages) == said + 1
    assert motor.save() == before


def test_every_flipped_bit_is_refused(motor):
    saved = motor.save()
    for bit in range(8 * len(saved)):
        damaged = bytearray(saved)
        damaged[bit // 8] ^= 1 << bit % 8
        refuse(motor, bytes(damaged), "the bytes are a damaged state")
    assert motor.load(saved) == OK


def test_states_of_another_size_or_build_are_refused(motor):
    saved = motor.save()
    array = "n" in motor.variables
    for content in (b"", saved[:-1], saved + b"\0", saved + saved):
        reason = f"{len(content)} bytes, but a state has {len(saved)}"
        refuse(motor, content, "" if array else reason)
    assert saved.startswith(b"{")
    refuse(motor, motor.sealed(b"{%c" % (saved[1] ^ 1) + saved[2:]), "another build")


# Places in a state of 3 motors behind its token, in bytes: see Head in array.c; of one motor, the
# names in `tests.fmus.conftest`.
TOKEN, MOST = 39, 65536
ARRAY = {
    "time": (0, "=d", (NAN, INF)), "owed": (8, "=d", (NAN, 1.1e-11)),
    "stop_time": (16, "=d", (NAN, -INF)), "life_cycle": (24, "=q", (0, 3, 32, 128)),
    "step_size": (32, "=d", (0.0, 1.0, NAN)),
    "n": (40, "=Q", (0, 1, 2, 4, MOST + 1, 2**64 - 1)), "closed_loop": (48, "=q", (2, -1)),
    "samples": (56, "=Q", (0, MOST + 1, 2**64 - 1)),
    "omega_des of motor 2": (72, "=d", (NAN, INF)),
    "m of motor 1": (64 + 4 * 24, "=d", (-1.0, NAN)),
    "J of motor 3": (64 + 7 * 24 + 16, "=d", (0.0, NAN)),
    "omega of motor 3": (64 + 19 * 24 + 16, "=d", (NAN, INF)),
}  # fmt: skip
SINGLE = {
    "theta": (NAN, INF), "omega": (NAN, -INF), "integral": (NAN, INF), "time": (NAN, INF),
    "owed": (NAN, 1.1e-11, -1.1e-11), "closed_loop": (-1, 2), "solver": (0, 3),
    "stop_time": (NAN, -INF), "life_cycle": (0, 3, 16, 32, -(2**63)),
}  # fmt: skip


@pytest.mark.parametrize("name", SINGLE)
def test_values_out_of_range_are_refused(instance, fmi, name):
    motor = instance(fmi).start(omega_des=700.0)
    for value in SINGLE[name]:
        refuse(motor, motor.with_field(motor.save(), name, value), "out of range")


@pytest.mark.parametrize("name", ARRAY)
def test_values_of_arrays_out_of_range_are_refused(array, name):
    motors, (place, form, values) = array(3).start(omega_des=700.0), ARRAY[name]
    for value in values:
        content = bytearray(motors.save())
        struct.pack_into(form, content, TOKEN + place, value)
        refuse(motors, motors.sealed(bytes(content)), "out of range")


def test_parameters_out_of_range_are_refused(motor):
    saved = motor.save()
    place = saved.index(struct.pack("=d", motor.get("J")[0]))
    for value in (0.0, -1e-9, NAN):
        content = saved[:place] + struct.pack("=d", value) + saved[place + 8 :]
        refuse(motor, motor.sealed(content), "out of range")


def test_other_sound_values_are_accepted(instance, fmi):
    motor = instance(fmi).start()
    for name, value in (("theta", 3.0), ("omega", 200.0), ("time", 5.0), ("owed", -1e-12)):
        assert motor.load(motor.with_field(motor.save(), name, value)) == OK, motor.messages
    assert motor.get("theta", "omega", "time") == [3.0, 200.0, 5.0]
    assert motor.do_step(5.0, 1e-5) == OK

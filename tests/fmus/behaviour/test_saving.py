"""Serialised states: damaged, foreign and impossible ones are refused, also of an array of one."""

import math
import struct

import numpy as np
import pytest

OK, ERROR = 0, 3
DOUBLE = "=d"


@pytest.fixture
def motor(instance, kind):
    motor = instance(kind).start(omega_des=700.0)
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
    array = "n" in motor.variables
    for content in (b"", saved[:-1], saved + b"\0", saved + saved):
        reason = f"{len(content)} bytes, but a state has {len(saved)}"
        refuse(motor, content, "" if array else reason)


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
        ("stop_time", (math.nan, -math.inf)),
        ("life_cycle", (0, 3, 16, 32, -(2**63))),
    ],
)
def test_values_out_of_range_are_refused(instance, fmi, name, values):
    motor = instance(fmi).start(omega_des=700.0)
    saved = motor.save()
    for value in values:
        refuse(motor, motor.with_field(saved, name, value), "out of range")


# Places in a state of 3 motors behind its token, in bytes: see Head in array.c.
TOKEN, MOST = 39, 65536
FIELDS = {
    "time": (0, "=d", (math.nan, math.inf)), "owed": (8, "=d", (math.nan, 1.1e-11)),
    "stop_time": (16, "=d", (math.nan, -math.inf)), "life_cycle": (24, "=q", (0, 3, 32, 128)),
    "step_size": (32, "=d", (0.0, 1.0, math.nan)),
    "n": (40, "=Q", (0, 1, 2, 4, MOST + 1, 2**64 - 1)), "closed_loop": (48, "=q", (2, -1)),
    "samples": (56, "=Q", (0, MOST + 1, 2**64 - 1)),
    "omega_des of motor 2": (72, "=d", (math.nan, math.inf)),
    "m of motor 1": (64 + 4 * 24, "=d", (-1.0, math.nan)),
    "J of motor 3": (64 + 7 * 24 + 16, "=d", (0.0, math.nan)),
    "omega of motor 3": (64 + 19 * 24 + 16, "=d", (math.nan, math.inf)),
}  # fmt: skip


@pytest.mark.parametrize("field", FIELDS)
def test_values_of_arrays_out_of_range_are_refused(array, field):
    motors, (place, form, values) = array(3).start(omega_des=700.0), FIELDS[field]
    saved = motors.save()
    for value in values:
        content = bytearray(saved)
        struct.pack_into(form, content, TOKEN + place, value)
        refuse(motors, motors.sealed(bytes(content)), "out of range")


def test_parameters_out_of_range_are_refused(motor):
    saved = motor.save()
    place = saved.index(struct.pack(DOUBLE, motor.get("J")[0]))
    for value in (0.0, -1e-9, math.nan):
        content = saved[:place] + struct.pack(DOUBLE, value) + saved[place + 8 :]
        refuse(motor, motor.sealed(content), "out of range")


def test_other_sound_values_are_accepted(instance, fmi):
    motor = instance(fmi).start()
    for name, value in (("theta", 3.0), ("omega", 200.0), ("time", 5.0), ("owed", -1e-12)):
        assert motor.load(motor.with_field(motor.save(), name, value)) == OK, motor.messages
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
            time_s = struct.unpack_from(DOUBLE, content, len(content) - 40)[0]
            motor.do_step(time_s, 1e-4)
            motor.call("Terminate")
    assert 50 < accepted < 450


def test_a_restored_motor_goes_on_as_the_saved_one(instance, fmi):
    """With its inputs, its parameters, and the time that its steps owe: 6e-12 s of each."""
    step_s, values = 1e-5 * (1.0 + 6e-7), {"omega_des": 700.0, "omega_noise": 5.0, "d": 1e-6}
    saved, restored = instance(fmi).start(J=4e-9, **values), instance(fmi).start()
    for k in range(101):
        assert saved.do_step(k * step_s, step_s) == OK
    assert restored.load(saved.save()) == OK
    for k in range(101, 105):
        assert saved.do_step(k * step_s, step_s) == restored.do_step(k * step_s, step_s) == OK
        assert saved.save() == restored.save()
        found = [
            motor.get("theta", "omega", "V_s", "i", *values, "J") for motor in (saved, restored)
        ]
        assert found[0] == found[1]

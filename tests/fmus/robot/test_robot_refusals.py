"""What the robot FMU refuses, and that instances leave nothing behind."""

import math
import os
import struct
from pathlib import Path

import pytest

OK, ERROR = 0, 3
STEP_S = 1e-5


def refused(robot, status: int, *words: str) -> None:
    assert status == ERROR
    assert all(word in robot.messages[-1] for word in words), robot.messages[-1]


@pytest.mark.parametrize("step_s", [1.5e-5, 0.4e-5, 1e-12, 1e-3 + 1e-9])
def test_steps_that_are_no_multiple_are_refused_and_change_nothing(robot, fmi, step_s):
    made = robot(fmi).start()
    before = made.save()
    refused(made, made.do_step(0.0, step_s), "give a multiple of step_size 1e-05 s")
    assert made.save() == before
    assert made.do_step(0.0, 1e-3) == OK
    assert made.do_step(1e-3, 1.0 / 3.0 - 0.332333333333333) == OK  # rounding of an importer


@pytest.mark.parametrize(
    ("name", "value", "word"),
    [("theta_D", math.nan, "finite"), ("omega_dot_E", math.inf, "finite"),
     ("F_x", math.nan, "finite"), ("mass", 0.0, "least"), ("restitution", 1.1, "most"),
     ("com_x", math.inf, "finite"), ("x", 1.0, "set"), ("lift_start", -1e-9, "least")],
)  # fmt: skip
def test_values_out_of_range_are_refused_by_name(robot, fmi, name, value, word):
    made = robot(fmi)
    before = made.save()
    refused(made, made.set(**{name: value}), name, word)
    assert made.save() == before


@pytest.mark.parametrize("last", [999, "x"])
def test_a_refused_call_sets_none_of_its_variables(robot, fmi, last):
    made = robot(fmi)
    for begin in (lambda: None, made.enter_initialization):
        begin()
        assert made.refuses_whole(last, extrapolate=False)
        assert made.refuses_whole(last, extrapolate=True)
        assert made.refuses_whole(last, mass=0.2, F_x=1.0)


def test_a_nan_while_it_runs_is_refused(robot, fmi):
    made = robot(fmi).start()
    assert made.do_step(0.0, STEP_S) == OK
    refused(made, made.set(omega_D=math.nan), "omega_D", "finite")
    refused(made, made.set(mass=0.2), "mass", "fixed parameter")
    refused(made, made.set(extrapolate=False), "extrapolate", "fixed parameter")
    assert made.do_step(STEP_S, STEP_S) == OK


def test_a_motion_that_overflows_is_refused_and_undone(robot, fmi):
    made = robot(fmi).start()
    assert made.set(F_x=1e308, M_z=1e308) == OK
    before = made.save()
    refused(made, made.do_step(0.0, 1e-3), "grew beyond all bounds")
    assert made.save() == before


def test_model_exchange_is_refused(robot, fmi):
    made = robot(fmi, model_exchange=True)
    assert made.handle is None
    assert "does not offer Model Exchange" in made.messages[-1]


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_impossible_states_are_refused(robot, fmi, value):
    made = robot(fmi).start()
    saved = made.save()
    place = saved.index(struct.pack("=d", made.get("z")[0]), 400)
    content = bytearray(saved)
    struct.pack_into("=d", content, place, value)
    refused(made, made.load(made.sealed(bytes(content))), "out of range")
    refused(made, made.load(saved[:-1] + b"x"), "damaged")
    assert made.save() == saved


def _held() -> tuple[int, int]:
    """Resident bytes and open files of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGESIZE"), len(list(Path("/proc/self/fd").iterdir()))


@pytest.mark.parametrize("model", ["robot", "instance"])
def test_instances_leave_nothing_behind(request, fmi, model):
    make = request.getfixturevalue(model)
    kept = make(fmi)

    def live() -> None:
        made = type(kept)(kept.library, kept.token, fmi, False, False, b"one of many")
        made.reference = kept.reference
        made.start()
        assert made.do_step(0.0, 1e-3) == OK
        assert made.load(made.save()) == OK
        made.free()

    for _ in range(200):
        live()
    memory, files = _held()
    for _ in range(2000):
        live()
    grown, files_now = _held()
    assert files_now == files
    assert grown - memory < 1_000_000  # an instance has some kB, as has its serialised state

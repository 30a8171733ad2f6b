"""Robots without feedback: what their motors get, what it costs, where it is refused."""

from typing import Any

import numpy as np
import pytest

import cosim
from cosim.base.arguments import ConfigError
from cosim.calibration.trial import Trial
from cosim.fmi.fmu import FmuError
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig, Loop
from cosim.model.preset import find_preset
from cosim.simulation.options import SimulationOptions
from tests.references.lines import drive_line

SPEED = 900.0
OPEN_LOOPS: tuple[tuple[Loop, ...], ...] = ((), ("heading",))


def samples(motor_fmu, **options):
    config = CoSimConfig(**options)
    with Trial(MotorFmu(motor_fmu), config, np.zeros(1), np.random.SeedSequence(0)) as trial:
        trial.set_motors(np.array([-SPEED, SPEED]))
        trial.advance(1000)
        return trial.advance(300)


def test_motors_in_open_loop_keep_the_set_point_in_the_mean(motor_fmu):
    found = samples(motor_fmu, open_loop=("motors",))
    assert np.ptp(found.voltage[:, 0, 1]) == 0.0
    assert found.voltage[0, 0, 0] == -found.voltage[0, 0, 1]
    assert np.abs(found.omega).mean() == pytest.approx(SPEED, rel=0.005)
    assert (found.omega_des[:, 0] == (-SPEED, SPEED)).all()
    assert np.ptp(samples(motor_fmu).voltage[:, 0, 1]) > 0.1  # the loop of Eq. (14)


def test_what_has_no_effect_is_refused():
    with pytest.raises(ConfigError, match=r"\(--noise\) .*--open-loop motors"):
        SimulationOptions(open_loop=("motors",), noise=0.1).config()
    with pytest.raises(ConfigError, match=r"open_loop.* = 'wheels' .*; choose .*motors"):
        CoSimConfig(open_loop=("wheels",))  # pyright: ignore[reportArgumentType]


def test_a_motor_without_voltage_input_is_refused(edited_fmu):
    def edit(description):
        description.find(".//Float64[@name='V_in']").set("name", "U")

    path = edited_fmu(edit)
    MotorFmu(path)
    with pytest.raises(FmuError, match=r"has no 'V_in', which --open-loop motors needs"):
        MotorFmu(path, open_loop=True)


def test_a_robot_without_course_keeps_the_heading_error_that_its_turn_left(motor_fmu):
    kept, straight = (
        drive_line(MotorFmu(motor_fmu), CoSimConfig(open_loop=loops), 0.02, 0.14, 2, seed=1)
        for loops in OPEN_LOOPS
    )
    assert kept.final_error_m.max() < 0.7e-3
    assert straight.final_error_m.min() > 2e-3
    assert np.abs(straight.heading_error_rad - 0.14).max() < 0.03


@pytest.mark.long
def test_runs_say_their_preset_and_what_goes_without_feedback(straight_policy):
    driving: dict[str, Any] = {
        "preset": "icra2006",
        "open_loop": ("motors",),
        "time_limit": 2.0,
        "speed": 0.5,
    }
    episode = cosim.simulate("1a", straight_policy(((15, 18),)), record="summary", **driving)
    assert episode.parameters["preset"].value == "icra2006"
    assert episode.parameters["open_loop"].value == "motors"
    assert episode.parameter("mu") == 0.4
    # its size is that of the machine, whatever the board
    assert episode.parameter("diameter_m") == find_preset("icra2006").config().robot.diameter_m

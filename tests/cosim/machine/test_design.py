"""Derivatives of the platform's speed, and the answers of `minirobots design`."""

import json
import math

import numpy as np
import pytest

from cosim.base.errors import USER_ERROR_STATUS, UserError
from cosim.machine.platform.design import design, foot_lift_speed, least_foot_force
from cosim.machine.platform.motion import (
    Platform,
    forces,
    net_speed,
    robot_platform,
    sensitivities,
)
from cosim.model.params import TABLE_I, TABLE_II


@pytest.mark.parametrize("omega", [850.0, 1000.0, 1145.0])
@pytest.mark.parametrize("mu", [0.1, 0.15, 0.4])
def test_sensitivities_are_those_of_finite_differences(omega, mu):
    platform, h = robot_platform(TABLE_I._replace(mu=mu)), 1e-5
    changes = {
        "unbalance": lambda k: (platform._replace(r=k * platform.r), omega),
        "mu": lambda k: (platform._replace(mu=k * platform.mu), omega),
        "mass": lambda k: (platform._replace(mass=k * platform.mass), omega),
        "omega": lambda k: (platform, k * omega),
    }
    found, speed = sensitivities(platform, omega), net_speed(platform, omega)
    assert found.keys() == changes.keys()
    for name, change in changes.items():
        slope = (net_speed(*change(1.0 + h)) - net_speed(*change(1.0 - h))) / (2.0 * h * speed)
        assert found[name] == pytest.approx(slope, rel=1e-6), name


def test_every_answer_gives_the_speed_with_a_foot_about_to_lift():
    found = design(TABLE_I, TABLE_II, 3.5e-3)
    assert not found.feet_stay_down
    assert found.motor_speed_rad_s and found.least_unbalance_kg_m and found.foot_radius_m
    platform = robot_platform()
    assert net_speed(platform, found.motor_speed_rad_s) == pytest.approx(3.5e-3, rel=1e-5)
    stronger = TABLE_II._replace(r=found.least_unbalance_kg_m / TABLE_II.m)
    answers = (
        (
            TABLE_I.spread(found.foot_radius_m / TABLE_I.foot_radius_m),
            TABLE_II,
            found.motor_speed_rad_s,
        ),
        (TABLE_I._replace(com_height_m=found.com_height_m), TABLE_II, found.motor_speed_rad_s),
        (TABLE_I, stronger, found.unbalance_motor_speed_rad_s),
    )
    for robot, motor, omega in answers:
        assert omega is not None
        assert net_speed(robot_platform(robot, motor), omega) == pytest.approx(3.5e-3, rel=1e-4)
        assert least_foot_force(robot, motor, omega) == pytest.approx(0.0, abs=1e-3)
        assert foot_lift_speed(robot, motor) == pytest.approx(omega, rel=1e-4)


def test_the_command_says_it_in_words_and_as_json(command):
    done = command("design", "--speed", 2, "--json")
    assert done.returncode == 0
    lines = done.stdout.splitlines()
    found = json.loads(lines[-1])
    assert found["feet_stay_down"]
    assert lines[1] == f"2 mm/s takes {found['motor_speed_rad_s']:.0f} rad/s, and no foot lifts."
    assert math.isclose(found["lift_off_rad_s"], 1151.15, rel_tol=1e-5)
    done = command("design", "--speed", 9, "--preset", "icra2006")
    assert "It leaves the floor before it reaches 9 mm/s." in done.stdout.splitlines()


def test_a_robot_that_tips_at_any_speed_is_refused():
    with pytest.raises(UserError, match="a foot lifts at any motor speed"):
        foot_lift_speed(TABLE_I.spread(1e-4), TABLE_II)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--speed", "0"), "speed = 0.0 is invalid: expected float > 0"),
        (("--speed", "1", "--mu", "-1"), "mu = -1.0 is invalid: expected float > 0"),
        (("--speed", "1", "--mu", "1e-9"), "with mu = 1e-09 the platform's motion does not come"),
        (("--speed", "1", "--mu", "1000"), "with mu = 1000 the platform stands still at 1151 rad"),
        (("--speed", "1", "--preset", "mine"), "unknown preset 'mine'"),
    ],
)
def test_mistakes_are_one_sentence(command, arguments, message):
    done = command("design", *arguments)
    assert done.returncode == USER_ERROR_STATUS
    assert done.stderr.count("\n") == 1
    assert message in done.stderr


def test_masses_that_a_weight_includes_hold_no_platform_twice():
    theta = np.linspace(0.0, 6.0, 7)
    apart = Platform(0.1, 2e-3, 1e-3, 0.4, 9.81)
    (driving, holds), (same, less) = (
        forces(each, 300.0, theta) for each in (apart, apart._replace(included=True))
    )
    assert same == pytest.approx(driving)
    assert holds - less == pytest.approx(np.full(7, 0.4 * 2e-3 * 9.81))

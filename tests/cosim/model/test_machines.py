"""Machine files with motors and feet of their own: read, written, refused."""

import math

import pytest

from cosim.base.errors import UserError
from cosim.model.params import Foot, lift_off_speed
from cosim.model.preset import find_preset
from docs.examples.draw_machine import machine

MOTOR = "[[motor]]\nplace_m = [0.0, 0.02, 0.003]\naxis = [0.0, 2.0, 0.0]\n"
FEET = "".join(
    f"[[foot]]\nplace_m = [{0.02 * math.cos(a)}, {0.02 * math.sin(a)}]\n" for a in (0.0, 2.1, 4.2)
)


def test_motors_and_feet_are_those_of_the_file(written):
    robot = find_preset(written(MOTOR + MOTOR.replace("axis", "r = 0.002\naxis") + FEET)).config()
    first, second = robot.robot.motors
    assert first.axis == (0.0, 1.0, 0.0)  # of length 1
    assert (first.own, dict(second.own)) == ((), {"r": 0.002})
    assert robot.robot.feet[0] == Foot(0.02, 0.0)
    assert robot.steering.forward_speed_rad_s == 0.0  # moves nothing before its calibration


def test_a_machine_is_read_as_it_was_written(tmp_path, written):
    preset = find_preset(written(machine(1)))
    preset.save(tmp_path / "again.toml")
    again = find_preset(tmp_path / "again.toml")
    assert again.config().robot == preset.config().robot
    droplet = find_preset("droplet")
    droplet.save(tmp_path / "droplet.toml")
    config = find_preset(tmp_path / "droplet.toml").config()
    assert (config.robot, config.motor) == (droplet.config().robot, droplet.config().motor)
    assert config.steering == droplet.config().steering


def test_vertical_shafts_lift_nothing():
    robot, level = find_preset("kilobot").config(), find_preset("paper").config()
    assert robot.lift_off_rad_s == pytest.approx(robot.top_speed_rad_s)
    assert lift_off_speed(level.robot, level.motor) < level.motor.V_s_max * 2000.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (MOTOR + "colour = 1\n" + FEET, "motor[0].colour is unknown"),
        ("foot = []\n", "foot"),
        (MOTOR * 9, "motor"),
        ("motor = []\n", "motor"),
        (MOTOR.replace("2.0", "0.0"), "has no length"),
        (MOTOR.replace("0.02", "nan"), "motor[0]"),
        (MOTOR + MOTOR.replace("axis", "m = -1\naxis") + FEET, "motor[1].m = -1 is invalid"),
        (MOTOR + MOTOR.replace("axis", "J = nan\naxis") + FEET, "motor[1].J = nan is invalid"),
        (MOTOR.replace("0.02", "20.0"), "give -10 to 10"),
        (MOTOR.replace("0.02", "0.03"), "outside the body"),
        (FEET.replace("0.02, 0.0]", "0.02, 0.0, 0.001]"), "µm above the floor"),
        (FEET.replace("[0.02", "[0.04"), "outside the body"),
        ("".join(f"[[foot]]\nplace_m = [0.0, {y}]\n" for y in (-0.01, 0.0, 0.02)), "falls over"),
        ("[body]\ncom_x_m = 0.03\n" + FEET, "falls over"),
        (FEET * 11, "foot"),
        (FEET + "mu = -1.0\n", "mu"),
        ("[body]\nmu = 0.2\n" + FEET.replace("[[foot]]", "[[foot]]\nmu = 0.3"), "has no effect"),
    ],
)
def test_what_cannot_stand_or_move_is_refused_in_one_line(written, text, words):
    with pytest.raises(UserError) as error:
        find_preset(written(text))
    assert words in str(error.value)
    assert "\n" not in str(error.value)

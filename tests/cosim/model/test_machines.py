"""Machine files with motors and feet of their own: read, written, refused."""

import math
from itertools import permutations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.base.errors import UserError
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_I, TABLE_II, Foot, MotorShares, lift_off_speed
from cosim.model.preset import Preset, built_in, find_preset
from cosim.simulation.options import Physics, SimulationOptions
from docs.examples.draw_machine import machine

MOTOR = "[[motor]]\nplace_m = [0.0, 0.02, 0.003]\naxis = [0.0, 2.0, 0.0]\n"
SHARES = "shares = {forwards = 1.0, left_turn = -0.5, dither = 0.25}\n"
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
    assert not robot.steering.given
    assert robot.robot.masses_included


def test_shares_of_motors_are_those_of_the_file(tmp_path, written):
    preset = find_preset(written(MOTOR + SHARES + MOTOR + SHARES.replace("0.5", "0.75") + FEET))
    steering = preset.config().steering
    assert steering.given
    assert steering.shares[0] == MotorShares(forwards=1.0, left_turn=-0.5, dither=0.25)
    assert {drive.difference for drive in steering.drives} == {(-0.5, -0.75)}
    assert steering.forward_speed_rad_s > 0.0
    preset.save(tmp_path / "again.toml")
    assert find_preset(tmp_path / "again.toml").config().steering == steering


def test_a_machine_is_read_as_it_was_written(tmp_path, written):
    stated = "g = 1.62\nJ = 2e-8\n"
    moon = MOTOR.replace("axis", f"{stated}m = 1e-4\naxis") + MOTOR.replace("axis", f"{stated}axis")
    presets = [find_preset(written(text)) for text in (machine(1), moon + FEET)]
    for preset in (*presets, *map(find_preset, built_in())):
        preset.save(tmp_path / "again.toml")
        read, expected = (
            {name: leaf.value for name, leaf in of.config().leaves().items() if name != "preset"}
            for of in (find_preset(tmp_path / "again.toml"), preset)
        )
        assert read == expected


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
        (MOTOR + SHARES + MOTOR, "motor[1] states no shares, but others do"),
        (MOTOR + "shares = {ahead = 1.0}\n", "motor[0].shares.ahead is unknown; choose one of"),
        (MOTOR + SHARES.replace("1.0", "2.0"), "motor[0].shares"),
        ("[drive]\npause_s = 0.01\n", "pause_s = 0.01 has no effect without pulses"),
        ("[drive]\npulse_s = 0.0304\n", "pulse_s = 0.0304 s is not a whole multiple of control"),
        ("[drive]\npulse_s = 0.0004\n", "pulse_s = 0.0004 s is not a whole multiple of control"),
        ("[drive]\npulse_s = 0.03\npause_s = 0.0015\n", "pause_s = 0.0015 s is not a whole"),
        ("[drive]\npulse_s = 0.03\n[motor]\nK_p = 0.02\n", "K_p has no effect where motors are"),
        (
            MOTOR.replace("axis", "K_i = 0.02\naxis") + MOTOR + "[drive]\npulse_s = 0.03\n",
            "K_i has no effect where motors are pulsed",
        ),
        (
            "[drive]\npulse_s = 0.03\n[world]\nmotor_speed_noise = 0.02\n",
            "motor_speed_noise (--noise) has no effect where motors are pulsed",
        ),
        (MOTOR.replace("0.003", "-0.001"), "place_m[2] = -0.001 above the floor"),
        (MOTOR.replace("0.003", "0.046"), "place_m[2] = 0.046 above the floor"),
        ("[body]\ncom_height_m = 0.05\n", "com_height_m = 0.05 is above the body"),
        ("[body]\nmass_kg = 0.0004\n" + MOTOR * 2, "mass_kg = 0.0004 is of the whole machine"),
        (MOTOR + MOTOR.replace("axis", "g = 1.62\naxis"), "g = 1.62 and 9.81; gravity is one"),
        ("[body]\ninertia_kg_m2 = [1e-5, 1e-5]\n", "has 2 moments; give Ixx, Iyy and Izz"),
    ],
)
def test_what_cannot_stand_or_move_is_refused_in_one_line(written, text, words):
    with pytest.raises(UserError) as error:
        find_preset(written(text))
    assert words in str(error.value)
    assert "\n" not in str(error.value)


moment = st.floats(1e-9, 1e-2)


@given(x2=moment, y2=moment, z2=moment, flat=st.booleans())
def test_moments_that_a_body_has_are_accepted(x2, y2, z2, flat):
    """Sums of m x² and so on of any body; a plate has no thickness."""
    z2 = 0.0 if flat else z2
    robot = TABLE_I._replace(inertia_kg_m2=(y2 + z2, x2 + z2, x2 + y2))
    assert CoSimConfig(robot=robot).robot == robot


@given(
    two=st.tuples(moment, moment),
    beyond=st.floats(1e-6, 10.0),
    order=st.permutations(range(3)),
    least=st.sampled_from([0.0, -1e-6, math.nan, math.inf]),
    count=st.integers(1, 6),
)
def test_moments_that_no_body_has_are_refused_by_name(two, beyond, order, least, count):
    triple = (*two, sum(two) * (1.0 + beyond))
    permuted = tuple(triple[k] for k in order)
    several = (two[0],) * (count if count != 3 else 7)
    for moments in (permuted, (*two, least), (least, *two), several):
        with pytest.raises(UserError, match="inertia_kg_m2"):
            CoSimConfig(robot=TABLE_I._replace(inertia_kg_m2=moments))


parameters = st.fixed_dictionaries(
    {},
    optional={
        name: st.sampled_from([usual, 1.25 * usual, 0.8 * usual])
        for name, usual in TABLE_II._asdict().items()
        if name != "g"
    },
)


@given(
    stated=st.lists(parameters, min_size=2, max_size=4),
    pulsed=st.booleans(),
    vertical=st.booleans(),
    data=st.data(),
)
@settings(max_examples=30)
def test_motors_and_feet_may_stand_in_any_order(written_once, stated, pulsed, vertical, data):
    if pulsed:
        stated = [{n: v for n, v in own.items() if n not in ("K_p", "K_i")} for own in stated]
    axis = [0.0, 0.0, 1.0] if vertical else [0.6, 0.0, 0.8]
    motors = [
        f"[[motor]]\nplace_m = [{0.004 * k}, 0.01, 0.003]\naxis = {axis}\n"
        + "".join(f"{name} = {value!r}\n" for name, value in own.items())
        for k, own in enumerate(stated)
    ]
    pulses = "[drive]\npulse_s = 0.03\n" if pulsed else ""
    feet = [f"[[foot]]\n{foot}" for foot in FEET.split("[[foot]]\n")[1:]]
    order = data.draw(st.permutations(range(len(motors))))
    others = [motors[k] for k in order]
    one = written_once("".join([*motors, *feet, pulses])).config()
    other = written_once("".join([*others, *data.draw(st.permutations(feet)), pulses])).config()
    assert other.motor == one.motor
    assert other.robot.motors == tuple(one.robot.motors[k] for k in order)
    assert {*other.robot.feet} == {*one.robot.feet}
    assert other.lift_off_rad_s == pytest.approx(one.lift_off_rad_s, rel=1e-12)
    tops = [one.top_speeds_rad_s[k] for k in order]
    assert other.top_speeds_rad_s == pytest.approx(tops, rel=1e-12)
    for mount, own in zip(one.robot.motors, stated, strict=True):
        assert dict(mount.own) == own


def test_what_a_motor_states_is_its_own(written):
    """Also where it is the usual value; an option holds for the motors that state nothing of it."""
    usual = MOTOR.replace("axis", f"r = {TABLE_II.r}\naxis")
    for tables in permutations([usual, MOTOR, MOTOR.replace("axis", "r = 0.002\naxis")]):
        options = Physics(preset=written("".join(tables)), motor_parameters=(("r", 0.0015),))
        config = options.config()
        assert config.motor.r == 0.0015
        stated = [dict(mount.own).get("r") for mount in config.robot.motors]
        expected = {usual: TABLE_II.r, MOTOR: None}
        assert stated == [expected.get(table, 0.002) for table in tables]
    options = Physics(preset=written(usual * 2), motor_parameters=(("r", 0.0015),))
    with pytest.raises(UserError, match=r"r = 0\.0015 has no effect: every motor of preset mine"):
        options.config()
    machine = find_preset(written(usual * 2))
    with pytest.raises(UserError, match=r"r = 0\.001 has no effect"):
        machine._replace(tree={**machine.tree, "r": (0.001, "edited")}).config()
    with pytest.raises(
        UserError, match=r"motor_speed_noise \(--noise\) has no effect where motors"
    ):
        SimulationOptions(preset="droplet", noise=0.1).config()


def test_gravity_is_that_of_all_motors(written):
    moon = MOTOR.replace("axis", "g = 1.62\naxis")
    config = find_preset(written(moon * 2)).config()
    assert (config.motor.g, config.robot.motors[0].own) == (1.62, ())


text = st.text()


@given(source=text, of_body=text, of_motor=text, of_foot=text)
@settings(max_examples=100)
def test_any_text_is_read_as_it_was_written(tmp_path_factory, source, of_body, of_motor, of_foot):
    robot = find_preset("kilobot").config().robot
    tree = {
        "mass_kg": (0.1, of_body),
        "inertia_kg_m2": ([1e-5, 2e-5, 3e-5], of_body),
        "motors": (robot.motors, of_motor or "the machine's file"),
        "feet": (robot.feet, of_foot or "the machine's file"),
        "pulse_s": (0.03, of_body),
        "motor_spread": (0.1, of_foot),
        "sensor_rate_hz": (30.0, of_motor),
    }
    preset = Preset("mine", source, tree)
    path = tmp_path_factory.mktemp("texts") / "mine.toml"
    preset.save(path)
    again = find_preset(path)
    common = [n for n in again.tree if n not in tree]  # what both motors state alike
    assert (again.source, {n: again.tree[n] for n in tree}) == (source, tree)
    assert {again.tree[n][1] for n in common} == {tree["motors"][1]}


@pytest.fixture(scope="module")
def written_once(tmp_path_factory):
    """Return the machine of a file's text."""
    path = tmp_path_factory.mktemp("machines") / "mine.toml"

    def preset(text):
        path.write_text(text, encoding="utf-8")
        return find_preset(path)

    return preset

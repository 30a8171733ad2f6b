"""Machines from files: what they set, what overrides them, what they may not say."""

import contextlib
import math
import re
from dataclasses import replace
from importlib.resources import files

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.base.command import MACHINES
from cosim.base.errors import UserError
from cosim.model.config import CoSimConfig
from cosim.model.params import STEERING, TABLE_I, TABLE_II
from cosim.model.preset import built_in, find_preset
from cosim.model.scenario_file import find_scenario
from cosim.model.world import IDEAL, Sensor, World
from cosim.simulation.options import Physics, SimulationOptions

WHOLE = """
source = "a machine"
[body]
mass_kg = 0.2
[motor]
K_T = 4e-4
source = "identified here"
[world]
restitution = 0.2
motor_speed_noise = 0.1
[world.sensor]
rate_hz = 30
[body.source]
mass_kg = "weighed"
"""


POGOBOTS = "pogobot-brush", "pogobot-rigid"


def test_built_in_machines_state_what_is_published():
    assert built_in() == ["paper", "droplet", "hexbug", "icra2006", "kilobot", *POGOBOTS, "thesis"]
    assert MACHINES.replace(" (Tables I and II)", "").split(", ")[:-2] == built_in()  # of --help
    assert find_preset("paper").config() == CoSimConfig()
    icra, thesis = (find_preset(name).config() for name in ("icra2006", "thesis"))
    assert (icra.robot.mu, icra.robot.diameter_m) == (0.4, 0.0365)
    assert icra.robot.foot_radius_m == pytest.approx(0.0292 / math.sqrt(3.0), rel=1e-3)
    assert (icra.robot.mass_kg, icra.motor) == (TABLE_I.mass_kg, TABLE_II)  # not published
    assert (thesis.robot.mu, thesis.robot.motors[0].place_m[1]) == (0.3, 0.022)


def test_a_file_says_what_differs_and_where_it_is_from(written):
    config = find_preset(written(WHOLE)).config()
    assert (config.robot.mass_kg, config.motor.K_T) == (0.2, 4e-4)
    assert (config.world.restitution, config.world.camera.rate_hz) == (0.2, 30.0)
    table = config.table()
    assert table["mass_kg"]["source"] == "weighed"
    assert table["K_T"]["source"] == "identified here"
    assert table["relative_amplitude"]["value"] == 0.1
    assert table["preset"]["value"] == "mine"
    # heavier robots lift off later, and nothing needs saying of the steering
    assert config.steering.forward_speed_rad_s < config.lift_off_rad_s


def test_a_light_machine_needs_no_other_steering(written):
    file = written("[body]\nmass_kg = 0.03")
    assert find_preset(str(file)).config().lift_off_rad_s < 700.0


def test_saved_and_read_again(written, tmp_path):
    preset = find_preset(written(WHOLE))
    preset.save(tmp_path / "again" / "mine.toml")
    assert find_preset(tmp_path / "again" / "mine.toml") == preset


def test_a_world_sets_what_a_machine_brings_along_back_to_ideal(written):
    """Also to 0: what is said explicitly holds, and is not shown with the machine's source."""
    world = World(restitution=0.0, motor_spread=0.0, motor_speed_noise=0.0, sensor=Sensor())
    file = written(
        "[world]\nrestitution = 0.2\nmotor_spread = 0.1\nmotor_speed_noise = 0.1\n"
        'source = "measured"\n[world.sensor]\nrate_hz = 30\nsource = "data sheet"\n'
    )
    names = ("restitution", "motor_spread", "relative_amplitude", "sensor_rate_hz")
    brought, ideal = (Physics(preset=file).config(w).table() for w in (IDEAL, world))
    assert [brought[name]["value"] for name in names] == [0.2, 0.1, 0.1, 30.0]
    assert [ideal[name]["value"] for name in names] == [0.0] * 4
    assert {ideal[name]["source"] for name in names} == {"world"}
    assert [brought[name]["source"] for name in names] == ["measured"] * 3 + ["data sheet"]


def test_sources_are_those_of_the_values(written):
    """Option over world over machine over default, and each value has the source of what won."""
    file, usual = written(WHOLE), CoSimConfig().table()
    options = {"mu": 0.15, "dt": 2e-5, "through": True, "speed": 3.0, "time_limit": 9}
    world = World(restitution=0.3, motor_speed_noise=0.0, payload_g=3.0)
    config = SimulationOptions(preset=file, **options).config(world, "world rough")
    assert config.world == World(restitution=0.3, payload_g=3.0, sensor=Sensor(rate_hz=30.0))
    assert (config.robot.mu, config.noise.relative_amplitude) == (0.15, 0.0)
    sources = {
        name: row["source"]
        for name, row in config.table().items()
        if row["source"] != usual[name]["source"]
    }
    given = ("mu", "dt_s", "communication_step_s", "drive_speed_m_s", "episode_limit_s")
    steering = [name for name in STEERING._fields if name.endswith("_speed_rad_s")]
    assert sources == {
        "mass_kg": "weighed",
        "K_T": "identified here",
        "sensor_rate_hz": "preset mine",
        "rl_step_s": "set by --through",
        **dict.fromkeys((*given, "through", "preset"), "given"),
        **dict.fromkeys(("restitution", "relative_amplitude", "payload_g"), "world rough"),
        **dict.fromkeys(steering, "computed: in proportion to lift-off"),
        "masses_included": "as weighed",
    }
    assert config.sized(0.051).table()["diameter_m"]["source"] == "scenario"
    assert config.unsourced == config


def test_a_machine_has_its_size_on_every_board(written):
    machine = find_preset(written("[body]\ndiameter_m = 0.051"))
    board, robot = machine.board(find_scenario("1a")), machine.config().robot
    assert board.diameter_m == robot.diameter_m
    assert board.squared_contact == round((100 * robot.diameter_m) ** 2)
    assert machine.config().sized(board.diameter_m).robot == robot
    message = "diameter_m = 0.051, but scenario 1a has robot_diameter_m = 0.03; leave it out"
    with pytest.raises(UserError, match=message):
        machine.board(replace(board, robot_diameter_m=0.03))
    small = replace(board, robot_diameter_m=0.03)
    assert find_preset("paper").board(small) == small  # whose robots have any size


def test_a_stated_size_is_kept_where_it_is_that_of_the_paper(written):
    machine = find_preset(written("[body]\ndiameter_m = 0.05"))
    with pytest.raises(UserError, match="preset mine states diameter_m"):
        machine.board(replace(find_scenario("1a"), robot_diameter_m=0.04))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[body]\nmuu = 1", "body.muu is unknown; choose one of mass_kg"),
        ("[steering]\ngain = 1", "steering is unknown; choose one of source, body"),
        ("[world]\nmu = 0.2", "world.mu is unknown; choose one of restitution"),
        ("[body]\nmass_kg = 'x'", "robot.mass_kg = 'x' is invalid: expected float"),
        ("[body]\nmass_kg = 0", "mass_kg = 0 is invalid: expected float > 0"),
        ("[motor]\nr = 0", "r = 0 is invalid: expected float > 0"),
        ("[body]\nmu = nan", "mu = nan is invalid"),
        ("[body]\ndiameter_m = 0.04", "a foot at (0.0115, 0.0199186) m is outside the body"),
        ("[world.sensor]\ndelay_ms = 2", "world.sensor.delay_ms has no effect without a camera"),
        ("body = 3", "body = 3 is invalid: expected table"),
        ("[body]\nsource = 3", "body.source = 3 is invalid: expected str"),
        ("[body.source]\nmu = 'x'", "body.source.mu is unknown"),
        ("mu = ", "not a TOML file"),
    ],
)
def test_mistakes_are_named(written, text, message):
    with pytest.raises(UserError, match=r"mine\.toml: ") as error:
        find_preset(written(text))
    assert message in str(error.value)


def test_other_names_are_refused():
    with pytest.raises(UserError, match=r"preset 'x'; choose .*paper, droplet, hexbug"):
        find_preset("x")


ODD = (
    *('"x"', "0", "-1", "1e308", "1e-308", "1e-6", "1e-3", "10", "1e9", "1e13", "100000"),
    *("true", "[]", "{}", "nan", "inf", "[1, 2]", "[[1]]", None),
)


@pytest.mark.long
@settings(max_examples=300)
@given(st.data(), st.sampled_from(built_in()[1:]), st.sampled_from(ODD))
def test_any_value_of_a_machine_is_taken_or_refused_by_name(tmp_path_factory, data, name, odd):
    lines = (files("cosim.model") / f"{name}.toml").read_text("utf-8").splitlines()
    stated = [k for k, line in enumerate(lines) if re.match(r"\w+ = ", line)]
    k = data.draw(st.sampled_from(stated))
    lines[k] = "" if odd is None else f"{lines[k].split(' = ')[0]} = {odd}"
    path = tmp_path_factory.getbasetemp() / "odd.toml"
    path.write_text("\n".join(lines), "utf-8")
    with contextlib.suppress(UserError):
        find_preset(path).config()

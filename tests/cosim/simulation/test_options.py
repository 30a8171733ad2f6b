"""One resolution of options: scenario, world, machine and options make a setup."""

import pytest

from cosim.base.arguments import ConfigError
from cosim.calibration.shielding import with_stopping_distance
from cosim.model.config import CoSimConfig
from cosim.model.params import SHIELD, SPEED_NOISE, TABLE_I
from cosim.model.scenario_file import find_scenario
from cosim.model.world import World
from cosim.simulation.options import SimulationOptions, resolve

MACHINE = "[robot]\nmu = 0.3\n[world]\nrestitution = 0.2\nmotor_speed_noise = 0.1\n"


@pytest.mark.parametrize(
    ("options", "world", "mu", "noise", "restitution"),
    [
        ({}, World(), 0.3, 0.1, 0.2),
        ({}, World(mu=0.2, motor_speed_noise=0.0, restitution=0.0), 0.2, 0.0, 0.0),
        ({"mu": 0.1, "noise": 0.02}, World(restitution=0.0), 0.1, 0.02, 0.0),
        ({"preset": "paper"}, World(), TABLE_I.mu, SPEED_NOISE.relative_amplitude, None),
    ],
)
def test_options_override_the_world_and_that_the_machine(
    tmp_path, options, world, mu, noise, restitution
):
    machine = tmp_path / "machine.toml"
    machine.write_text(MACHINE)
    config = SimulationOptions(**{"preset": str(machine)} | options).config(world)
    assert (config.robot.mu, config.noise.relative_amplitude) == (mu, noise)
    assert config.world.restitution == restitution


@pytest.mark.slow
def test_a_setup_has_obstacles_of_its_world_and_a_shield_for_it(motor_fmu):
    world = World(obstacles=((3, 4),), edge=True)
    setup = resolve(SimulationOptions(shield=True, motor_fmu=motor_fmu), "2", world=world)
    assert set(setup.scenario.obstacles) == {*find_scenario("2").obstacles, (3, 4)}
    assert setup.config.world.edge and not setup.config.world.obstacles
    assert setup.config == with_stopping_distance(setup.config, setup.fmu)
    assert setup.config.shield not in {None, SHIELD}
    assert setup.fmu == motor_fmu


def test_a_scenario_is_refused_before_anything_is_measured(tmp_path):
    def refuse(scenario):
        raise ConfigError(f"not {scenario.name}")

    with pytest.raises(ConfigError, match="not 2"):
        resolve(SimulationOptions(motor_fmu=tmp_path / "missing.fmu"), "2", require=refuse)


def test_a_time_limit_is_the_end_of_an_rl_step():
    with pytest.raises(ConfigError, match=r"time_limit = 5 s is not a whole multiple of rl_step_s"):
        SimulationOptions(time_limit=5.0).config()
    config = SimulationOptions(time_limit=5.0, through=True).config()
    assert config.timing.episode_limit_s == 5.0


@pytest.mark.parametrize("shield", [True, "yes", 1.0])
def test_a_shield_is_a_record_or_none(shield):
    with pytest.raises(ConfigError, match="shield = "):
        CoSimConfig(shield=shield)

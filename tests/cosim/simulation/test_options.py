"""One resolution of options: scenario, world, machine and options make a setup."""

from typing import Any

import pytest

from cosim.base.arguments import ConfigError
from cosim.base.progress import silent
from cosim.calibration.shielding import with_stopping_distance
from cosim.model.config import CoSimConfig
from cosim.model.params import SHIELD
from cosim.model.scenario_file import find_scenario
from cosim.model.world import World
from cosim.simulation.options import (
    EpisodeOptions,
    Physics,
    SimulationOptions,
    differing,
    resolve,
)
from minirobots.commands.episodes import Run, slowed


@pytest.mark.slow
def test_a_setup_has_obstacles_of_its_world_and_a_shield_for_it(motor_fmu):
    world = World(obstacles=((3, 4),), edge=True)
    options = SimulationOptions(shield=True, motor_fmu=motor_fmu)
    scenario, config, fmu = resolve(options, "2", world=world)
    assert set(scenario.obstacles) == {*find_scenario("2").obstacles, (3, 4)}
    assert config.world.edge and not config.world.obstacles
    assert config == with_stopping_distance(config, fmu)
    assert config.shield not in {None, SHIELD}
    assert fmu == motor_fmu


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


def test_show_config_prints_every_parameter_with_its_source(tmp_path, capsys, monkeypatch):
    world = tmp_path / "icy.toml"
    world.write_text("[world]\nmu = 0.1\n")
    physics = EpisodeOptions(world=world, noise=0.1, record="summary")
    run = Run(scenario="1a", show_config=True, physics=physics, out=tmp_path / "out")
    monkeypatch.setattr("cosim.calibration.measuring.calibrated", None)  # nothing is measured
    run.run(silent).show()
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(CoSimConfig().table())
    assert "robot.mu = 0.1  (world icy)" in lines
    assert "noise.relative_amplitude = 0.1  (given)" in lines
    assert "timing.rl_step_s = 2.0 s  (Section V)" in lines
    assert [
        line for line in lines if line.startswith("steering.turn_speed") and "(calibrated" in line
    ]
    assert not (tmp_path / "out").exists()


def test_what_differs_from_the_default_is_listed_and_slow_robots_are_explained():
    config = CoSimConfig().having("given", mu=0.3)
    slower = config.having("computed: the largest speed without hopping", drive_speed_m_s=0.0022)
    assert {name: leaf.value for name, leaf in differing(config).items()} == {"mu": 0.3}
    assert slowed(config) == slowed(slower.having("given", drive_speed_m_s=0.001)) == ""
    assert slowed(slower).startswith(
        "robots drive 2.2 mm/s, not 3.9: the largest speed without hopping (mu = 0.3)"
    )


def test_a_communication_step_is_its_own_and_a_machine_has_its_motors():
    timing = Physics(dt=1e-5, communication_step=1e-4).config().timing
    assert (timing.dt_s, timing.communication_step_s) == (1e-5, 1e-4)
    motors: Any = {"preset": "kilobot", "motor_parameters": (("J", 6e-9),)}
    assert Physics(mu=0.3, reaction=True, **motors).machine == Physics(**motors)

"""The stopping distance that the shield's claim rests on."""

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.errors import UserError
from cosim.base.storage import CACHE, cache_dir
from cosim.calibration import shielding
from cosim.calibration.shielding import (
    RESERVE,
    bound_of,
    corners,
    path_diameter,
    stopping_paths,
    turning_path,
    with_stopping_distance,
)
from cosim.fmi.motor import MotorFmu, with_motor
from cosim.model.config import CoSimConfig
from cosim.model.params import SHIELD
from cosim.model.world import Patch, Sensor, World
from cosim.simulation.options import SimulationOptions


def stopping_m(config):
    assert config.shield is not None
    return config.shield.stopping_m


@pytest.fixture
def quick(monkeypatch, tmp_path):
    """Few stops, measured again by kernels that are there."""
    for folder in (cache_dir("fmus"), cache_dir("kernels")):
        (tmp_path / folder.name).symlink_to(folder, target_is_directory=True)
    monkeypatch.setenv(CACHE, str(tmp_path))
    for name, count in (("ROBOTS", 32), ("TRIALS", 1), ("ROUNDS", 8)):
        monkeypatch.setattr(shielding, name, count)


@pytest.mark.long
def test_robots_stop_within_what_the_shield_allows_for(motor_fmu):
    stops = stopping_paths(CoSimConfig(), MotorFmu(motor_fmu), 32, seed=9)
    assert 0.02e-3 < stops.path_m.max() < SHIELD.stopping_m / RESERVE
    assert stops.rest_s.max() < 0.03


def test_held_robots_stand_still_on_a_slope_whatever_the_speed_noise(motor_fmu):
    """Motors without set point have no noise: before, these robots slid by 1 mm in a minute."""
    world = World(mu=0.03, floor_tilt_deg=1.0, motor_speed_noise=0.2)
    config = CoSimConfig().in_world(world)
    config = replace(config, steering=config.steering._replace(max_speed_rad_s=600.0))
    stops = stopping_paths(config, MotorFmu(motor_fmu), 8, seed=0)
    assert stops.path_m.max() > 1e-5
    assert stops.creep_m_s.max() * 3600.0 < 1e-6  # a micrometre in an hour


@pytest.mark.long
def test_robots_stop_later_the_less_friction_there_is(motor_fmu):
    """So that of whole floors it is enough to measure on the most slippery one."""
    fmu, usual = MotorFmu(motor_fmu), CoSimConfig()
    floors = [replace(usual, robot=usual.robot._replace(mu=mu)) for mu in (0.12, 0.2, 0.3)]
    moved = [stopping_paths(config, fmu, 16, seed=0).path_m.max() for config in floors]
    assert moved == sorted(moved, reverse=True)


def test_a_path_is_as_long_as_its_diameter():
    """Not as its largest distance from where it begins."""
    there_and_back = np.array([[0.0, 0.0], [3.0, 4.0], [-3.0, -4.0], [0.0, 0.1]])
    (diameter,) = path_diameter(there_and_back[:, None])
    assert 10.0 <= diameter < 10.02


@pytest.mark.parametrize("tail", ["exponential", "uniform"])
def test_the_bound_is_exceeded_by_at_most_one_stop_in_1e5(tail):
    rng = np.random.default_rng(0)
    true = {"exponential": np.log(1e5), "uniform": 1.0 - 1e-5}[tail]
    bounds = np.array([bound_of(getattr(rng, tail)(size=(256, 8))) for _ in range(300)])
    assert np.mean(bounds >= true) > 0.95  # of an exponential tail 0.99, but for the threshold
    assert np.median(bounds) < 1.6 * true


def test_few_robots_with_long_paths_make_the_bound_less_sure():
    rng = np.random.default_rng(0)
    paths = rng.exponential(size=(256, 8))
    few = np.sort(paths, axis=None).reshape(paths.shape)  # the longest are of 13 robots
    assert bound_of(few) > 1.2 * bound_of(paths)


def test_floors_meet_under_the_feet():
    world = World(mu_patches=(Patch((0, 0, 1, 1), 0.05), Patch((2, 2, 3, 3), 0.3)))
    origins = np.column_stack([np.arange(1.0, 65.0), np.ones(64)])
    floors = corners(CoSimConfig(world=world), origins, np.random.default_rng(0))
    assert set(np.unique(floors[:, :, 4])) == {0.05, 0.15, 0.3}
    distance = np.abs(floors[:, 0, 2:4] - origins).max(axis=1)
    assert np.mean(distance < CoSimConfig().robot.foot_radius_m) > 0.3
    inside = (floors[:, :, :2] <= origins[:, None]) & (origins[:, None] < floors[:, :, 2:4])
    assert (inside.all(axis=2).sum(axis=1) == 1).all()
    assert not corners(CoSimConfig(), origins, np.random.default_rng(0)).size


@pytest.mark.long
def test_motors_without_control_take_longer_to_stop(motor_fmu):
    configs, fmu = (CoSimConfig(), CoSimConfig(open_loop=("motors",))), MotorFmu(motor_fmu)
    controlled, coasting = (stopping_paths(c, fmu, 16, seed=0).path_m.max() for c in configs)
    assert 1.2 * controlled < coasting < 1e-3


@pytest.mark.long
@pytest.mark.parametrize(
    "world", [World(mu_patches=(Patch((0, 0, 1, 1), 0.05),)), World(floor_tilt_deg=3.0)]
)
def test_a_slippery_patch_and_a_slope_count(motor_fmu, quick, tmp_path, world):
    config, worse = CoSimConfig(), CoSimConfig(world=world)
    usual, longer = (stopping_m(with_stopping_distance(c, motor_fmu)) for c in (config, worse))
    assert usual < longer
    assert stopping_m(with_stopping_distance(config, motor_fmu)) == usual  # from the cache
    floors = 3 if world.mu_patches else 2  # the patch everywhere, and its edges
    assert len(list(tmp_path.glob("calibrations/*.json"))) == floors


@pytest.mark.long
def test_a_slope_that_robots_slide_down_is_refused(motor_fmu, quick):
    with pytest.raises(UserError, match="slide on"):
        with_stopping_distance(CoSimConfig(world=World(floor_tilt_deg=10.0)), motor_fmu)


WORLDS = {
    "the paper's": World(),
    "unequal motors": World(motor_spread=0.3),
    "bouncing feet": World(restitution=0.9),
    "slope": World(floor_tilt_deg=4.0),
    "slippery slope": World(mu=0.03, floor_tilt_deg=1.0, motor_speed_noise=0.2),
    "patches": World(
        mu=0.16,
        mu_patches=(Patch((4, 4, 12, 26), 0.22), Patch((18, 2, 27, 9), 0.12)),
        motor_spread=0.05,
        restitution=0.2,
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", WORLDS)
def test_other_stops_stay_within_the_bound(name):
    """Of 2048 other stops 0.02 are expected beyond the bound, and fewer with the reserve."""
    config, fmu = SimulationOptions(shield=True).prepare(world=WORLDS[name])
    others = [stopping_paths(config, MotorFmu(fmu), 64, seed) for seed in range(100, 104)]
    bound_m = stopping_m(config) / RESERVE
    assert max(stops.path_m.max() for stops in others) < bound_m
    assert max(stops.creep_m_s.max() for stops in others) == 0.0


@pytest.mark.long
def test_a_camera_that_leaves_no_room_is_refused(motor_fmu, quick, monkeypatch):
    monkeypatch.setattr("cosim.calibration.straying.ROBOTS", 8)
    monkeypatch.setattr("cosim.calibration.straying.LENGTH_S", 3.0)
    worse = CoSimConfig(world=World(sensor=Sensor(rate_hz=2.0, position_noise_mm=8.0)))
    with pytest.raises(UserError, match=r"stops robots \d+ mm apart.*world.sensor"):
        with_stopping_distance(worse, motor_fmu)


def test_the_motors_of_a_user_are_those_that_are_measured(
    edited_fmu, motor_fmu, quick, monkeypatch
):
    """With their parameters, and with those that their file has, also where it can set none."""
    for name, count in (("ROBOTS", 4), ("ROUNDS", 2)):
        monkeypatch.setattr(shielding, name, count)

    def sluggish(root):
        for variable in root.iter("Float64"):
            if variable.get("name") == "b":
                variable.set("name", "damping")

    config = CoSimConfig()
    foreign = edited_fmu(sluggish, motor_fmu)
    given = (replace(config, motor_parameters=(("K_p", value),)) for value in (0.001, 0.004))
    read = with_motor(config.having("given", mu=0.2), foreign)
    found = [stopping_m(with_stopping_distance(c, motor_fmu)) for c in (config, *given)]
    assert len(set(found)) == 3
    unknown = replace(read, motor=read.motor._replace(b=1e-9))  # the FMU cannot be given it
    assert stopping_m(with_stopping_distance(unknown, foreign)) > 0.0


@pytest.mark.long
def test_half_a_turn_moves_the_centre_around_its_circle(motor_fmu):
    """The paper's robot turns about a point 2.8 mm ahead, and without its dither drifts, too."""
    (moved_m,) = turning_path(CoSimConfig(), MotorFmu(motor_fmu))
    assert 2.0 * 2.7e-3 < moved_m < 4.0 * 3e-3
    slow = CoSimConfig().having("test", turn_speed_rad_s=300.0)
    with pytest.raises(UserError, match="turn too slowly"):
        turning_path(slow, MotorFmu(motor_fmu))

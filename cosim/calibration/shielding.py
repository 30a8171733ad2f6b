"""Configurations with the shield: what it keeps is measured for their machine and world, once."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec

from cosim.base.errors import UserError
from cosim.base.progress import Progress, silent, under_way
from cosim.base.provenance import digest_of
from cosim.base.storage import cache_dir, cached, write_json
from cosim.calibration.stopping import RESERVE, SLIDES, stopping_distance
from cosim.calibration.straying import best_filter
from cosim.coupling.fmu import MotorFmu
from cosim.model.config import CoSimConfig
from cosim.model.params import ESTIMATOR, SHIELD, TIMING
from cosim.model.preset import PAPER
from cosim.model.world import World
from cosim.onboard.shield import stopping_gap
from fmus.build import identity_of_fmu

VERSION = 1  # of stopping distances and errors of estimates: raise it when their bits change
MOST_GAP = 0.5  # assumed: of the robots' diameter; with more there is no way past each other
_FLOOR = ("motor_spread", "restitution", "floor_tilt_deg", "payload_g", "payload_offset_mm")


def _reduced(config: CoSimConfig, *fields: str) -> CoSimConfig:
    """Return a configuration without what decides nothing here, and with these fields of its world.

    So that the measurement is found again: decisions, limits and names decide nothing.
    """
    clock = ("dt_s", "communication_step_s", "control_period_s")
    return replace(
        config,
        timing=TIMING._replace(**{name: getattr(config.timing, name) for name in clock}),
        world=World(**{name: getattr(config.world, name) for name in fields}),
        portable=False,
        on_collision="end",
        through=False,
        shield=None,
        preset=PAPER,
        estimator=config.estimator if "sensor" in fields else ESTIMATOR,
        sources=(),
    )


def _kept(
    measure: Callable[[CoSimConfig, MotorFmu], tuple[float, ...]],
    config: CoSimConfig,
    motor_fmu: Path,
) -> tuple[float, ...]:
    """Return the measurements for a configuration, from the cache if they are there."""
    key = digest_of(config, identity_of_fmu(motor_fmu), measure.__name__, VERSION)
    return cached(
        cache_dir("calibrations") / f"{key}.json",
        lambda path: msgspec.json.decode(path.read_bytes(), type=tuple[float, ...]),
        lambda: measure(config, MotorFmu(motor_fmu)),
        lambda found, path: write_json(path, found),
    )


def with_stopping_distance(
    config: CoSimConfig, motor_fmu: Path, progress: Progress = silent
) -> CoSimConfig:
    """Return a calibrated configuration with the shield for its machine and world.

    The stopping distance is measured once and kept in the cache; on a floor of patches on the most
    slippery one, and across their edges. So is the error of estimates where there is a camera.

    Raises:
        UserError: robots do not come to rest, or estimates are so bad that robots would
            stop too far from each other.
        FmuError: the FMU cannot be used, or failed.
    """
    world, shield = config.world, config.shield or SHIELD
    least_mu = min([config.robot.mu, *(patch.mu for patch in world.mu_patches)])
    slippery = _reduced(replace(config, robot=config.robot._replace(mu=least_mu)), *_FLOOR)
    patchy = _reduced(config, *_FLOOR, "mu_patches")
    with under_way(progress, "measuring stopping distances"):
        floors = [slippery, patchy] if world.mu_patches else [slippery]
        stops = [_kept(stopping_distance, floor, motor_fmu) for floor in floors]
    bound_m, creep_m_s = map(max, zip(*stops, strict=True))
    stopping_m = math.ceil(1e6 * RESERVE * bound_m) / 1e6
    if creep_m_s * config.timing.episode_limit_s > stopping_m - bound_m:
        raise UserError(SLIDES.format(f"on, by {3.6e6 * creep_m_s:.2g} mm in an hour"))
    config = replace(config, shield=shield).having("measured", stopping_m=stopping_m)
    if not world.camera.rate_hz:
        return config
    seen = _reduced(config, *_FLOOR, "mu_patches", "sensor")
    with under_way(progress, "measuring errors of estimates"):
        drift, deviations, deviation_m = _kept(best_filter, seen, motor_fmu)
    config = config.having(
        "measured",
        deviations=math.ceil(100.0 * deviations) / 100.0,
        position_drift_m2_s=drift,
    )
    assert config.shield is not None
    gap_m = stopping_gap(math.sqrt(2.0) * deviation_m, config.shield)
    if gap_m > MOST_GAP * config.robot.diameter_m:
        raise UserError(
            f"positions are too uncertain in this world: the shield stops robots {1e3 * gap_m:.0f} "
            f"mm apart, more than {MOST_GAP:g} of their diameter; leave out --shield, or change "
            "world.sensor, world.floor_tilt_deg or world.mu_patches"
        )
    return config

"""Calibrations found again, and configurations with the motor speeds that they give.

The trials are `cosim.calibration.measuring`; the command line is `minirobots calibrate`.
"""

from dataclasses import replace
from pathlib import Path

from cosim.base.progress import Progress, silent
from cosim.base.provenance import digest_of
from cosim.base.storage import cache_dir, cached
from cosim.calibration.measuring import VERSION, measure
from cosim.calibration.speed_map import DRIVES, Calibration, load_calibration
from cosim.coupling.fmu import MotorFmu
from cosim.coupling.parameters import with_motor
from cosim.model.config import CoSimConfig
from fmus.build import identity_of_fmu


def digest(config: CoSimConfig, motor_fmu: Path) -> str:
    """Hash (16 hex digits) of what a calibration depends on: robot, motors, clock, noise."""
    timing = config.timing
    clock = (timing.dt_s, timing.communication_step_s, timing.control_period_s)
    further = [given for given in config.motor_parameters if given[0] not in config.motor._fields]
    return digest_of(
        config.robot,
        config.motor,
        config.noise,
        clock,
        config.steering.dither_rad_s,
        config.reaction,
        (config.world.restitution or 0.0, config.world.payload_g, config.world.payload_offset_mm),
        identity_of_fmu(motor_fmu),
        VERSION,
        *([further] if further else []),
    )


def find_calibration(
    config: CoSimConfig,
    motor_fmu: Path,
    progress: Progress = silent,
    *,
    jobs: int = 2,
    again: bool = False,
) -> Calibration:
    """The calibration of a configuration: found in the cache, or measured and kept there.

    Args:
        config: of the co-simulation.
        motor_fmu: of every motor.
        progress: receives the trials done.
        jobs: threads.
        again: measure even if the calibration is there.

    Raises:
        FmuError: the FMU cannot be used, or failed.
    """
    config = replace(config, open_loop=())  # speeds are those of motors under control
    MotorFmu(motor_fmu)  # a missing or foreign file is named before anything is hashed
    path = cache_dir("calibrations") / f"{digest(config, motor_fmu)}.npz"

    def make() -> Calibration:
        return measure(config, motor_fmu, jobs, progress)

    return cached(path, load_calibration, make, Calibration.save, again=again)


def calibrated_slower(
    config: CoSimConfig, motor_fmu: Path, progress: Progress = silent
) -> CoSimConfig:
    """Return a configuration as `calibrated` does, at most at the largest speed without hopping.

    Args: as of `find_calibration`.

    Raises:
        UserError: they do not move.
        FmuError: the FMU cannot be used, or failed.
    """
    config = with_motor(config, motor_fmu)
    calibration = find_calibration(config, motor_fmu, progress)
    speeds = [config.steering.drive_speed_m_s, *(calibration.largest(d) for d in DRIVES)]
    calibration.require_motion(config.robot.mu)
    if min(speeds) < config.steering.drive_speed_m_s:
        source = "computed: the largest speed without hopping"
        config = config.having(source, drive_speed_m_s=min(speeds))
    return calibration.resolved(config)


def calibrated(config: CoSimConfig, motor_fmu: Path, progress: Progress = silent) -> CoSimConfig:
    """The configuration with the motor speeds that realise its drive speed and turn rate.

    Args: as of `find_calibration`.

    Raises:
        UserError: the drive speed needs hopping.
        FmuError: the FMU cannot be used, or failed.
    """
    config = with_motor(config, motor_fmu)
    return find_calibration(config, motor_fmu, progress).resolved(config)

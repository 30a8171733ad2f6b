"""`python -m cosim.calibrate`: the map between motor speeds and motion, as files and a plot."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from cosim.base.command import Jobs, Json, parse, print_json, workers
from cosim.base.errors import run_command
from cosim.base.progress import Progress, progress_bars
from cosim.base.storage import replacing, write_json
from cosim.fmi.isolation import Isolation
from cosim.navigation.options import Physics

if TYPE_CHECKING:
    from cosim.calibration.report import CalibrationReport
    from cosim.calibration.speed_map import Calibration


@dataclass(frozen=True, kw_only=True)
class Calibrate:
    """Calibrate the drive: which motor speeds give which speed and which yaw rate.

    Co-simulates single robots with their motor FMUs and noise, forwards, backwards, left and right,
    over motor speeds, speed differences and phases between the motors, and writes the map, its
    scatter and a plot. The co-simulation calibrates itself likewise when robot, motors, FMU,
    clock, noise or code change; this command shows what it found.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/calibration")
    """Output folder: calibration.npz, calibration.json, calibration.png."""
    again: bool = False
    """Measure even if the cache has this calibration."""
    jobs: Jobs = -1
    json: Json = False
    physics: Annotated[Physics, tyro.conf.OmitArgPrefixes] = field(default_factory=Physics)
    isolation: Annotated[Isolation, tyro.conf.OmitArgPrefixes] = field(default_factory=Isolation)

    def __post_init__(self) -> None:
        workers(self.jobs)


def calibrate(options: Calibrate, progress: Progress) -> "tuple[Calibration, CalibrationReport]":
    """Find or measure the calibration and write its files.

    Args:
        options: the command line.
        progress: is told what is prepared and measured.

    Raises:
        UserError: see its message.
    """
    from cosim.calibration.cache import find_calibration
    from cosim.calibration.report import draw, report_of
    from cosim.coupling.parameters import with_motor

    config, out = options.physics.config(), options.out
    out.mkdir(parents=True, exist_ok=True)
    fmu = options.physics.fmu(progress)
    config = with_motor(config, fmu)
    calibration = find_calibration(
        config, fmu, progress, jobs=workers(options.jobs), again=options.again
    )
    report = report_of(calibration, config, fmu)
    calibration.save(out / "calibration.npz")
    write_json(out / "calibration.json", report)
    title = f"One robot, μ = {config.robot.mu:g}, noise ±{config.noise.relative_amplitude:.0%}"
    with replacing(out / "calibration.png") as temporary:
        draw(calibration, title).savefig(temporary, dpi=150)
    return calibration, report


def main() -> None:
    """Command line; see `Calibrate`."""
    options = parse(Calibrate, "cosim.calibrate")
    options.isolation.enter("cosim.calibrate", options.physics.motor_fmu)
    from cosim.base.command import show_table
    from cosim.calibration.report import manoeuvre_rows

    with progress_bars() as progress:
        calibration, report = calibrate(options, progress)
    header = ("manoeuvre", "motor speed", "mean", "scatter", "airborne")
    show_table(None, header, manoeuvre_rows(calibration))
    print(
        f"without hopping: motors up to {report.hop_free_rad_s:.0f} rad/s, "
        f"{1e3 * report.largest_speed_m_s:.2f} mm/s in both directions, "
        f"{math.degrees(report.largest_turn_rate_rad_s):.1f} °/s in both directions"
    )
    print(f"results in {options.out}/: calibration.npz, .json, .png")
    if options.json:
        print_json(report)


if __name__ == "__main__":
    run_command(main)

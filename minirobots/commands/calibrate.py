"""Map motor speeds to speed and yaw rate, as files and a plot."""

import math
from collections.abc import Iterator
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any

import tyro

from cosim.base.progress import Progress
from cosim.simulation.options import Physics
from minirobots.options import Folder, IsolatedOptions, Jobs


class Calibrate(IsolatedOptions):
    """Calibrate the drive: measure the speed and yaw rate that motor speeds give.

    Co-simulates single robots with their motor FMUs and noise, forwards, backwards, left and right,
    over motor speeds, speed differences and phases between the motors, and writes the map, its
    scatter and a plot. The co-simulation calibrates itself likewise when robot, motors, FMU, clock,
    noise or code change; this command shows the result.
    """

    out: Folder = Path("runs/calibration")
    """Output folder: calibration.npz, calibration.json, calibration.png."""
    again: bool = False
    """Measure even if the cache has this calibration."""
    jobs: Jobs = -1
    physics: Annotated[Physics, tyro.conf.OmitArgPrefixes] = field(default_factory=Physics)


def run(options: Calibrate, progress: Progress) -> Iterator[Any]:
    """Find or measure the calibration, write its files, and print the possible speeds."""
    from cosim.base.command import workers
    from cosim.base.storage import replacing, write_json
    from cosim.base.table import show_texts
    from cosim.calibration.measuring import find_calibration
    from cosim.calibration.report import draw, manoeuvre_rows, report_of
    from cosim.fmi.motor import with_motor

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
    yield report
    header = ("manoeuvre", "motor speed", "mean", "scatter", "airborne")
    show_texts(header, manoeuvre_rows(calibration))
    print(
        f"without hopping: motors up to {report.hop_free_rad_s:.0f} rad/s, "
        f"{1e3 * report.largest_speed_m_s:.2f} mm/s in both directions, "
        f"{math.degrees(report.largest_turn_rate_rad_s):.1f} °/s in both directions"
    )
    print(f"results in {out}/: calibration.npz, .json, .png")

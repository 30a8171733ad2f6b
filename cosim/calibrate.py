"""`python -m cosim.calibrate`: the map between motor speeds and motion, as files and a plot."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from cosim.base.config import ConfigError, CoSimConfig
from cosim.base.errors import run_command
from cosim.base.params import SPEED_NOISE, STEERING, TABLE_I, TIMING
from cosim.base.storage import replacing
from cosim.navigation.calibration import DRIVES, MANOEUVRES, Calibration
from cosim.navigation.calibration_cache import digest, find_calibration
from fmus.build import cached_fmu

SCHEMA_VERSION = 1
# Colours told apart in any kind of colour vision (Okabe and Ito).
_COLOURS = {
    "forwards": "#0072b2",
    "backwards": "#d55e00",
    "left": "#009e73",
    "right": "#cc79a7",
}


@dataclass(frozen=True)
class Calibrate:
    """Calibrate the drive: which motor speeds give which speed and which yaw rate.

    Co-simulates single robots with their motor FMUs and noise, forwards, backwards, left and right,
    over motor speeds, speed differences and phases between the motors, and writes the map, its
    scatter and a plot. The co-simulation calibrates itself likewise when robot, motors, FMU,
    clock, noise or code change; this command shows what it found.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/calibration")
    """Output folder: calibration.npz, calibration.json, calibration.png."""
    mu: float = TABLE_I.mu
    """Coulomb friction coefficient of the feet (useful: 0.1 to 0.4)."""
    noise: float = SPEED_NOISE.relative_amplitude
    """Half width of the uniform noise on measured motor speeds, relative to the motor speed."""
    dt: Annotated[float, tyro.conf.arg(metavar="S")] = TIMING.dt_s
    """Integration step of the bodies in s."""
    motor_fmu: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Motor FMU to use (FMI 3.0 Co-Simulation with the same interface) instead of the built-in."""
    jobs: int = 2
    """Threads; the result does not depend on it."""
    again: bool = False
    """Measure even if the cache has this calibration."""
    json: bool = False
    """Print a JSON object as the last line of output."""

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise ConfigError("--jobs must be at least 1")

    def config(self) -> CoSimConfig:
        """Parameters of the co-simulation.

        Raises:
            ConfigError: they do not fit together.
        """
        return CoSimConfig(
            robot=TABLE_I._replace(mu=self.mu),
            noise=SPEED_NOISE._replace(relative_amplitude=self.noise),
            timing=TIMING._replace(dt_s=self.dt, communication_step_s=self.dt),
        )


def report_of(calibration: Calibration, config: CoSimConfig, motor_fmu: Path) -> dict[str, Any]:
    """What calibration.json holds and `--json` prints; units in the names."""
    curves = {}
    for manoeuvre in MANOEUVRES:
        unit = "m_s" if manoeuvre in DRIVES else "rad_s"
        for dithered in (True, False):
            curve = calibration.curve(manoeuvre, dithered=dithered)
            name = manoeuvre if dithered else f"{manoeuvre}_without_dither"
            if len(curve.omega_rad_s):
                curves[name] = {
                    "motor_speed_rad_s": curve.omega_rad_s.tolist(),
                    f"mean_{unit}": curve.mean.tolist(),
                    f"scatter_{unit}": curve.scatter.tolist(),
                    "airborne_share": curve.airborne_share.tolist(),
                }
    return {
        "schema_version": SCHEMA_VERSION,
        "digest": digest(config, motor_fmu),
        "mu": config.robot.mu,
        "trials": len(calibration.phase_rad),
        "hop_free_rad_s": calibration.hop_free_rad_s,
        "largest_speed_m_s": min(calibration.largest(drive) for drive in DRIVES),
        "largest_turn_rate_rad_s": min(calibration.largest(side) for side in ("left", "right")),
        "curves": curves,
    }


def draw(calibration: Calibration, title: str) -> Figure:
    """Speeds, yaw rates, and what speed differences and motor phases do."""
    figure = Figure(figsize=(10.0, 7.5), layout="constrained")
    (speeds, rates), (differences, phases) = figure.subplots(2, 2)
    figure.suptitle(title)
    for manoeuvre in MANOEUVRES:
        axes, factor = (speeds, 1e3) if manoeuvre in DRIVES else (rates, np.rad2deg(1.0))
        for dithered in (True, False):
            curve = calibration.curve(manoeuvre, dithered=dithered)
            if not len(curve.omega_rad_s):
                continue
            label = manoeuvre if dithered else f"{manoeuvre}, without dither"
            style = {"capsize": 3.0} if dithered else {"linestyle": "--", "alpha": 0.6}
            axes.errorbar(
                curve.omega_rad_s,
                factor * curve.mean,
                factor * curve.scatter,
                color=_COLOURS[manoeuvre],
                label=label,
                **style,
            )
    for axes, name in ((speeds, "speed, mm/s"), (rates, "yaw rate, °/s")):
        axes.axvline(calibration.hop_free_rad_s, color="0.5", linestyle=":", label="hops above")
        axes.set(xlabel="motor speed, rad/s", ylabel=name)
        axes.legend()
    _draw_differences(differences, calibration)
    _draw_phases(phases, calibration)
    return figure


def _draw_differences(axes: Axes, calibration: Calibration) -> None:
    """Yaw rate of a driving robot over the speed added to both motors."""
    added = calibration.set_points_rad_s.sum(axis=1) / 2.0
    base = (calibration.set_points_rad_s[:, 1] - calibration.set_points_rad_s[:, 0]) / 2.0
    for manoeuvre in DRIVES:
        differs = (added != 0.0) & (base * MANOEUVRES[manoeuvre][1] > np.abs(added))
        slow, *_, fast = np.unique(np.abs(base[differs]))
        for speed, style in ((fast, "o-"), (slow, "x--")):
            chosen = differs & (np.abs(base) == speed)
            axes.plot(
                added[chosen],
                np.rad2deg(calibration.yaw_rate_rad_s[chosen]),
                style,
                color=_COLOURS[manoeuvre],
                label=f"{manoeuvre}, {speed:.0f} rad/s",
            )
    axes.set(xlabel="speed added to both motors, rad/s", ylabel="yaw rate, °/s")
    axes.legend()


def _draw_phases(axes: Axes, calibration: Calibration) -> None:
    """Yaw rate over the initial phase between the motors at the speed nearest to that driven at."""
    speed = np.abs(calibration.set_points_rad_s[~calibration.dithered, 1])
    nearest = speed[np.abs(speed - STEERING.forward_speed_rad_s).argmin()]
    for manoeuvre in ("forwards", "left"):
        d, e = MANOEUVRES[manoeuvre]
        for dithered, style in ((True, "o-"), (False, "x--")):
            set_points = calibration.set_points_rad_s == nearest * np.array([d, e])
            chosen = set_points.all(axis=1) & (calibration.dithered == dithered)
            axes.plot(
                np.rad2deg(calibration.phase_rad[chosen]),
                np.rad2deg(calibration.yaw_rate_rad_s[chosen]),
                style,
                color=_COLOURS[manoeuvre],
                label=f"{manoeuvre}, {'with' if dithered else 'without'} dither",
            )
    axes.set(
        xlabel=f"initial phase between the motors, ° ({nearest:.0f} rad/s)", ylabel="yaw rate, °/s"
    )
    axes.legend()


def _show(calibration: Calibration, report: dict[str, Any], console: Console) -> None:
    table = Table("manoeuvre", "motor speed", "mean", "scatter", "airborne")
    for manoeuvre in MANOEUVRES:
        curve = calibration.curve(manoeuvre)
        factor, unit = (1e3, "mm/s") if manoeuvre in DRIVES else (np.rad2deg(1.0), "°/s")
        columns = (curve.omega_rad_s, curve.mean, curve.scatter, curve.airborne_share)
        for omega, mean, scatter, airborne in zip(*columns, strict=True):
            table.add_row(
                manoeuvre,
                f"{omega:.0f} rad/s",
                f"{factor * mean:.2f} {unit}",
                f"{factor * scatter:.2f}",
                f"{airborne:.2%}",
            )
    console.print(table)
    console.print(
        f"without hopping: motors up to {report['hop_free_rad_s']:.0f} rad/s, "
        f"{1e3 * report['largest_speed_m_s']:.2f} mm/s in both directions, "
        f"{np.rad2deg(report['largest_turn_rate_rad_s']):.1f} °/s in both directions",
        soft_wrap=True,
    )


def calibrate(options: Calibrate, console: Console) -> tuple[Calibration, dict[str, Any]]:
    """Find or measure the calibration and write its files.

    Args:
        options: the command line.
        console: for progress; nothing is drawn if it is no terminal.

    Returns:
        The calibration and the content of calibration.json.

    Raises:
        UserError: see its message.
    """
    config = options.config()
    with console.status("preparing the motor FMU (some seconds the first time)"):
        fmu = options.motor_fmu or cached_fmu()
    options.out.mkdir(parents=True, exist_ok=True)
    calibration = find_calibration(config, fmu, console, jobs=options.jobs, again=options.again)
    report = report_of(calibration, config, fmu)
    calibration.save(options.out / "calibration.npz")
    with replacing(options.out / "calibration.json") as temporary:
        temporary.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    title = f"One robot, μ = {config.robot.mu:g}, noise ±{config.noise.relative_amplitude:.0%}"
    with replacing(options.out / "calibration.png") as temporary:
        draw(calibration, title).savefig(temporary, dpi=150)
    return calibration, report


def main() -> None:
    """Command line; see `Calibrate`."""
    options = tyro.cli(
        Calibrate, prog="python -m cosim.calibrate", config=(tyro.conf.FlagCreatePairsOff,)
    )
    stdout = Console()
    calibration, report = calibrate(options, Console(stderr=True))
    _show(calibration, report, stdout)
    stdout.print(f"results in {options.out}/: calibration.npz, .json, .png", soft_wrap=True)
    if options.json:
        print(json.dumps(report))


if __name__ == "__main__":
    run_command(main)

"""Results of identification as files: numbers, a preset for the simulation, and a report."""

import math
from pathlib import Path

import msgspec
import numpy as np
from matplotlib.figure import Figure

from cosim.base.colours import BLUE, GREEN, VERMILION
from cosim.base.plotting import styled
from cosim.base.progress import Progress, silent
from cosim.base.reading import naming
from cosim.base.storage import replacing, write_json, write_whole
from cosim.base.table import Column, field, format_value, markdown
from cosim.fmi.motor import with_motor
from cosim.machine.identification.fit import QUANTILE, UNKNOWN, Fit, fit, rises, unidentifiable
from cosim.machine.identification.plausible import require_plausible
from cosim.machine.identification.simulated import UNITS, Simulated, machine, simulated_drive
from cosim.machine.identification.track import SeenTrack, require_rigid
from cosim.model.config import UNKNOWN as UNKNOWN_SOURCE
from cosim.model.config import CoSimConfig
from cosim.model.preset import Preset

PRESET_FILE, DRAWING_FILE = "preset.toml", "tracks.svg"
MOST_RATE_HZ = 1000.0  # of the camera in a preset


class Estimate(msgspec.Struct, frozen=True, kw_only=True):
    """A parameter in identification.json, SI units."""

    # name, description: see `cosim.machine.identification.simulated.RobotParameter`
    name: str
    description: str
    value: float
    # low, high: interval of 95 %, see `cosim.machine.identification.fit`; None if there are doubts
    low: float | None
    high: float | None
    identifiable: bool  # whether the track says more of it than was assumed before
    # Of the sum of squares at the ends of the interval, by simulation: 3.84 if the model were
    # linear; None where an end is out of bounds
    rises: tuple[float | None, ...]


class Identification(msgspec.Struct, frozen=True, kw_only=True):
    """The content of identification.json."""

    schema_version: int = 1
    track: str
    preset: str
    frames: int
    duration_s: float
    parameters: tuple[Estimate, ...]
    doubts: tuple[str, ...]  # why there are no intervals, as text
    # The mass and its interval of 95 %, if any, if the motors' mean unbalance is the usual one: all
    # else is with the mass of the preset, and tracks tell only the ratio of the two
    mass_kg: tuple[float, float | None, float | None]
    unidentifiable: tuple[str, ...]  # what the track says nothing of, as text
    # Of the camera, and how the robot strays from any simulation, by largest likelihood
    noise: dict[str, float]
    evaluations: int


def _value(estimate: Estimate) -> str:
    scale, unit = UNITS.get(estimate.name, (1.0, ""))
    return f"{scale * estimate.value:.3f} {unit}".rstrip()


def _interval(estimate: Estimate) -> str:
    scale, _ = UNITS.get(estimate.name, (1.0, ""))
    if estimate.low is None or estimate.high is None:
        return "none"
    if not estimate.identifiable:
        return "not identifiable"
    return f"{scale * estimate.low:.3f} to {scale * estimate.high:.3f}"


COLUMNS = (
    field("name", heading="parameter"),
    field("description", heading="what it is"),
    Column("value", _value),
    Column("95 % interval", _interval),
    Column("rises", lambda row: ", ".join(format_value(rise, "{:.1f}") for rise in row.rises)),
)


def identify(
    track: SeenTrack,
    name: str,
    preset: Preset,
    config: CoSimConfig,
    fmu: Path,
    out: Path,
    progress: Progress = silent,
) -> Identification:
    """Identify a robot, and write identification.json, preset.toml, report.md and the drawing.

    `preset` is what is not identified, and the usual values of what is.
    """
    require_rigid(preset.name, config.robot)
    progress("turning the motors", 0, None)
    drive = simulated_drive(track, with_motor(config, fmu), fmu)
    progress("turning the motors", 1, 1)
    require_plausible(name, track, drive)
    found = fit(track, drive, progress)
    half, ends = QUANTILE * found.deviations, rises(track, drive, found)
    report = Identification(
        track=name,
        preset=preset.name,
        frames=len(track.times),
        duration_s=float(track.times[-1]),
        parameters=tuple(
            Estimate(
                name=parameter.name,
                description=parameter.description,
                value=float(found.values[k]),
                low=None if found.doubts else float(found.values[k] - half[k]),
                high=None if found.doubts else float(found.values[k] + half[k]),
                identifiable=bool(found.deviations[k] < UNKNOWN * parameter.spread),
                rises=tuple(None if math.isnan(rise) else rise for rise in ends[k].tolist()),
            )
            for k, parameter in enumerate(drive.parameters)
        ),
        doubts=found.doubts,
        mass_kg=_mass_kg(drive, found),
        unidentifiable=tuple(unidentifiable(found, drive.parameters)),
        noise=found.noise._asdict(),
        evaluations=found.evaluations,
    )
    write_json(out / "identification.json", report)
    with replacing(out / DRAWING_FILE) as temporary:
        _draw(track, found).savefig(temporary, format="svg", metadata={"Date": None})
    write_whole(out / "report.md", _text(report))
    own = _preset(track, name, preset, drive, found)
    with naming(out / PRESET_FILE):
        own.config()  # refuses what no reader would take
    own.save(out / PRESET_FILE)
    return report


def _mass_kg(drive: Simulated, found: Fit) -> tuple[float, float | None, float | None]:
    """Return the mass, and its interval, with which the mean of the motors' factors is 1."""
    motors = [k for k, p in enumerate(drive.parameters) if p.name.startswith("motor_")]
    half = QUANTILE * math.sqrt(found.covariance[np.ix_(motors, motors)].sum()) / len(motors)
    means = found.values[motors].mean() + np.array([0.0, half, -half])
    value, low, high = drive.config.robot.mass_kg / np.clip(means, *drive.limits[:, motors[0]])
    return (float(value), None, None) if found.doubts else (float(value), float(low), float(high))


def _preset(track: SeenTrack, name: str, preset: Preset, drive: Simulated, found: Fit) -> Preset:
    """The machine."""
    config = drive.config
    robot, motors = machine(found.values, config.robot, config.motor)
    where = f"identified from {name}"
    intervals = {
        p.name: f"{where}: "
        + (
            f"without an interval: {'; '.join(found.doubts)}"
            if found.doubts
            else f"95 % within ± {QUANTILE * deviation * p.scale:.2g} {p.unit}".rstrip()
        )
        for p, deviation in zip(drive.parameters, found.deviations, strict=True)
    }
    tree = {n: leaf for n, leaf in preset.tree.items() if not n.startswith("sensor_")}
    tree |= {
        n: (getattr(config.motor, n), text)
        for n, text in config.sources
        if n in config.motor._fields and not text.startswith(UNKNOWN_SOURCE)
    }
    tree |= {n: (getattr(robot, n), t) for n, t in intervals.items() if n in robot._fields}
    sources = dict(config.sources)
    placed = sources.get("feet", f"as of preset {preset.name}")
    if all(foot.mu is not None for foot in robot.feet):
        placed += f"; mu in proportion to one {tree.pop('mu')[1]}"
    own = [
        mount._replace(own=tuple({**dict(mount.own), "r": motor.r}.items()))
        for mount, motor in zip(robot.motors, motors, strict=True)
    ]
    tree.pop("r", None)  # what all stated alike before
    mounted = sources.get("motors", f"as of preset {preset.name}")
    tree |= {
        "feet": (robot.feet, placed),
        "motors": (tuple(own), f"{mounted}; unbalance over m {where}"),
    }
    if config.steering.given:
        tree["shares"] = (config.steering.shares, mounted)
    rate_hz = min(MOST_RATE_HZ, round(float(1.0 / np.median(np.diff(track.times))), 3))
    delay_ms = round(1e3 * float(found.values[-1]), 2)
    heading_deg = round(float(np.rad2deg(found.noise.heading_rad)), 4)
    tree |= {
        "sensor_rate_hz": (rate_hz, where),
        "sensor_delay_ms": (delay_ms, intervals["camera_delay_s"]),
        "sensor_position_noise_mm": (round(1e3 * found.noise.position_m, 4), where),
        "sensor_heading_noise_deg": (heading_deg, where),
    }
    source = f"Identified from {name}; all else is of the preset {preset.name}."
    return Preset(Path(PRESET_FILE).stem, source, tree)


def mass_text(report: Identification) -> str:
    """Return the mass as a sentence."""
    value, *ends = (f"{1e3 * mass_kg:.4g}" for mass_kg in report.mass_kg if mass_kg is not None)
    interval = f" ({' to '.join(ends)})" if ends else ""
    return f"if the mean unbalance is the usual one instead, the mass is {value} g{interval}"


def _text(report: Identification) -> str:
    """The report as Markdown."""
    unknown = [f"- {words}" for words in report.unidentifiable]
    doubts = f"**There are no intervals**: {'; '.join(report.doubts)}.\n\n" if report.doubts else ""
    noise = report.noise
    return f"""# Parameters identified from {report.track}

{report.frames} frames in {report.duration_s:.1f} s; all else is of the preset {report.preset}. The
robot as it was identified is in [{PRESET_FILE}]({PRESET_FILE}), for `--preset`.

{doubts}{markdown(COLUMNS, report.parameters)}

The rise is that of the sum of squares at the ends of the interval, by simulation. Were the model
linear, it would be {QUANTILE**2:.2f}; intervals are widened where it was not.

The mass is that of the preset; {mass_text(report)}.

## What the track cannot tell

{chr(10).join(unknown) or "It tells something of every parameter."}

## Tracks and residuals

![Tracks, headings and residuals]({DRAWING_FILE})

Errors of the camera: {1e3 * noise["position_m"]:.2f} mm and
{np.rad2deg(noise["heading_rad"]):.2f}°. What the speed noise does to a robot stays, so that the
tracks above part; residuals are from frame to frame.
"""


@styled
def _draw(track: SeenTrack, fit: Fit) -> Figure:
    """Tracks seen and simulated, headings, and residuals."""
    seen, own = track.poses, _laid_over(fit.frames, track.poses)
    figure = Figure(figsize=(10.0, 8.0), layout="constrained")
    (plane, turning), (errors, spread) = figure.subplots(2, 2)
    for poses, colour, form, label in (
        (seen, BLUE, ".", "seen"),
        (own, VERMILION, "-", "simulated"),
    ):
        plane.plot(1e3 * poses[:, 0], 1e3 * poses[:, 1], form, color=colour, ms=1.5, label=label)
        turning.plot(track.times, np.rad2deg(poses[:, 2]), form, color=colour, ms=1.5, label=label)
    plane.set(title="track", xlabel="x, mm", ylabel="y, mm", aspect="equal")
    plane.legend()
    turning.set(title="heading", xlabel="s", ylabel="°")
    for k, (name, colour) in enumerate((("x", BLUE), ("y", GREEN), ("heading", VERMILION))):
        residuals = fit.residuals[:, k]
        errors.plot(track.times[1:], residuals, ".", ms=2, color=colour, label=name)
        spread.hist(residuals, bins=np.linspace(-5.0, 5.0, 41), histtype="step", color=colour)
    errors.set(title="residuals over their standard deviations", xlabel="s")
    errors.legend()
    spread.set(title="the same, counted", xlabel="standard deviations", ylabel="frames")
    return figure


def _laid_over(frames: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """The simulated track (n, 3), moved and turned as a whole to where the robot was seen."""
    turn = np.mean(poses[:, 2] - frames[:, 2])
    places, seen = (track[:, 0] + 1j * track[:, 1] for track in (frames, poses))
    places = places * np.exp(1j * turn)
    places += np.mean(seen - places)
    return np.column_stack([places.real, places.imag, frames[:, 2] + turn])

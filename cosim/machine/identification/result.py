"""Results of identification as files: numbers, a preset for the simulation, and a page."""

from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from cosim.base.progress import Progress, silent
from cosim.base.storage import write_json
from cosim.coupling.fmu import MotorFmu
from cosim.coupling.parameters import with_motor
from cosim.machine.identification.fit import QUANTILE, UNKNOWN, Fit, fit, rises, unidentifiable
from cosim.machine.identification.noise import Noise
from cosim.machine.identification.parameters import PARAMETERS, SPREADS, machine
from cosim.machine.identification.simulated import simulated
from cosim.machine.identification.track import SeenTrack
from cosim.model.config import CoSimConfig
from cosim.model.preset import Preset
from cosim.model.world import Sensor

JSON_FILE, PRESET_FILE, PAGE_FILE = "identification.json", "preset.toml", "report.html"


class Estimate(msgspec.Struct, frozen=True, kw_only=True):
    """A parameter in identification.json, SI units.

    Attributes:
        name, description: see `cosim.machine.identification.parameters.RobotParameter`.
        value: that fits best.
        low, high: interval of 95 %, by the covariance of Gauss and Newton.
        identifiable: whether the track says more of it than was assumed before.
        rises: of the sum of squares at the ends of the interval, by simulation: 3.84 if the model
            were linear; None where an end is out of bounds.
    """

    name: str
    description: str
    value: float
    low: float
    high: float
    identifiable: bool
    rises: tuple[float | None, float | None]


class Identification(msgspec.Struct, frozen=True, kw_only=True):
    """The content of identification.json.

    Attributes:
        track: the file.
        preset: what was taken for all else.
        frames, duration_s: of the track.
        parameters: in the order of `cosim.machine.identification.parameters`.
        unidentifiable: what the track says nothing of, as text.
        noise: of the camera, and how the robot strays from any simulation, by largest likelihood.
        evaluations: batches of simulations.
    """

    schema_version: int = 1
    track: str
    preset: str
    frames: int
    duration_s: float
    parameters: tuple[Estimate, ...]
    unidentifiable: tuple[str, ...]
    noise: dict[str, float]
    evaluations: int


@dataclass(frozen=True)
class Identified:
    """All that files are made of."""

    report: Identification
    preset: Preset
    track: SeenTrack
    fit: Fit


def identify(
    track: SeenTrack,
    name: str,
    preset: Preset,
    config: CoSimConfig,
    fmu: Path,
    progress: Progress = silent,
) -> Identified:
    """Identify a robot.

    Args:
        track: seen.
        name: of the track.
        preset: what is not identified, and the usual values of what is.
        config: of the simulation.
        fmu: of its motors.
        progress: receives what is done.

    Raises:
        UserError: the FMU cannot be used, or failed.
    """
    config = with_motor(config, fmu)
    preset = preset._replace(motor=config.motor, sources=dict(config.sources))
    set_points = track.set_points(config.timing.control_period_s)
    progress("turning the motors", 0, None)
    drive = simulated(set_points, track.times, MotorFmu(fmu), config)
    progress("turning the motors", 1, 1)
    found = fit(track, drive, progress)
    report = _report(track, name, preset, found, rises(track, drive, found))
    return Identified(report, _preset(track, name, preset, found), track, found)


def _report(
    track: SeenTrack, name: str, preset: Preset, found: Fit, ends: np.ndarray
) -> Identification:
    half = QUANTILE * found.deviations
    identifiable = found.deviations < UNKNOWN * SPREADS
    return Identification(
        track=name,
        preset=preset.name,
        frames=len(track.times),
        duration_s=float(track.times[-1]),
        parameters=tuple(
            Estimate(
                name=parameter.name,
                description=parameter.description,
                value=float(found.values[k]),
                low=float(found.values[k] - half[k]),
                high=float(found.values[k] + half[k]),
                identifiable=bool(identifiable[k]),
                rises=(_known(ends[k, 0]), _known(ends[k, 1])),
            )
            for k, parameter in enumerate(PARAMETERS)
        ),
        unidentifiable=tuple(unidentifiable(found)),
        noise=found.noise._asdict(),
        evaluations=found.evaluations,
    )


def _known(value: float) -> float | None:
    return None if np.isnan(value) else float(value)


def _preset(track: SeenTrack, name: str, preset: Preset, found: Fit) -> Preset:
    """The machine, with the mean of both motors, and their difference as the motors' spread."""
    robot, motor_d, motor_e = machine(found.values, preset.robot, preset.motor)
    mean = 0.5 * (motor_d.r + motor_e.r)
    # standard deviation of the two
    spread = min(abs(motor_d.r - motor_e.r) / (2.0**0.5 * mean), 0.3)
    noise: Noise = found.noise
    sensor = Sensor(
        rate_hz=round(float(1.0 / np.median(np.diff(track.times))), 3),
        delay_ms=round(1e3 * float(found.values[-1]), 2),
        position_noise_mm=round(1e3 * noise.position_m, 4),
        heading_noise_deg=round(float(np.rad2deg(noise.heading_rad)), 4),
    )
    where = f"identified from {name}"
    intervals = {
        parameter.name: f"{where}: 95 % within ± {half:.2g} {unit}".rstrip()
        for parameter, half, unit in zip(
            PARAMETERS,
            QUANTILE * found.deviations * [p.scale for p in PARAMETERS],
            [p.unit for p in PARAMETERS],
            strict=True,
        )
    }
    sources = dict(preset.sources) | {
        name: text for name, text in intervals.items() if name in robot._fields
    }
    sources |= {
        "r": f"{where}: mean of both motors' unbalance, over m",
        "motor_spread": f"{where}: from the difference of the two motors",
        "sensor_delay_ms": intervals["camera_delay_s"],
        "sensor_rate_hz": where,
        "sensor_position_noise_mm": where,
        "sensor_heading_noise_deg": where,
    }
    world = msgspec.structs.replace(preset.world, motor_spread=round(spread, 4), sensor=sensor)
    source = f"Identified from {name}; all else is of the preset {preset.name}."
    motor = preset.motor._replace(r=mean)
    return Preset(Path(PRESET_FILE).stem, source, robot, motor, world, sources)


def write(identified: Identified, out: Path) -> None:
    """Write identification.json, preset.toml and report.html."""
    # here, because drawing is slow to import
    from cosim.machine.identification.page import write_page  # noqa: PLC0415

    write_json(out / JSON_FILE, identified.report)
    identified.preset.save(out / PRESET_FILE)
    write_page(identified, out / PAGE_FILE)

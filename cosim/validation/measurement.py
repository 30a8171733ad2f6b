"""What is measured to hold the simulation against published machines, kept as it comes."""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from cosim.base.config import CoSimConfig
from cosim.base.progress import Progress, silent
from cosim.base.provenance import digest_of
from cosim.base.reached_code import code_digest
from cosim.base.reading import Kind, read_json
from cosim.base.storage import cache_dir, cached, write_json
from cosim.calibration.cache import calibrated
from cosim.coupling.fmu import MotorFmu
from cosim.coupling.parameters import with_motor
from cosim.presets.preset import PAPER, PresetError, find_preset
from cosim.validation.driving import (
    Leg,
    MeasuredSpeed,
    drive_by_the_clock,
    measured_speed,
    polygon,
    sideways,
)
from cosim.validation.published import PATHS, SPEEDS, PublishedPath, PublishedSpeed
from cosim.validation.sensitivity import closed_form, sensitivities

# Three V of 1 cm legs and 20° to either side (assumed; what was published of them is not at hand).
V_STEPS, V_LEG_M, V_HALF_RAD = 3, 0.01, math.radians(20.0)
_FILE = Kind("kept measurement", "measure it again", PresetError)


class Effort(NamedTuple):
    """How much is simulated: phases between the motors, and robots that drive each path."""

    phases: int = 8
    robots: int = 8


QUICK = Effort(2, 2)


class Sensitivity(NamedTuple):
    """Relative derivatives of the speed forwards at a published point.

    Attributes:
        point: where.
        dynamics, platform: d ln v / d ln p by the parameter, ours and in closed form.
    """

    point: PublishedSpeed
    dynamics: dict[str, float | None]
    platform: dict[str, float]


class DrivenPath(NamedTuple):
    """A path by the clock alone; a row per robot.

    Attributes:
        path: published, None for the V-shaped steps.
        dithered: whether motors had the steering's dither.
        ends: (robots, 3) displacement in m and turned angle in rad, beside what was meant.
    """

    path: PublishedPath | None
    dithered: bool
    ends: list[list[float]]


class Validation(NamedTuple):
    """All that is measured, in the order of the tables."""

    speeds: list[tuple[PublishedSpeed, MeasuredSpeed]]
    sensitivities: list[Sensitivity]
    paths: list[DrivenPath]


def validate(
    motor_fmu: Path,
    effort: Effort = Effort(),  # noqa: B008 - a constant
    seed: int = 0,
    jobs: int = 2,
    progress: Progress = silent,
) -> Validation:
    """Measure, or find again what was measured.

    Args:
        motor_fmu: of every motor.
        effort: phases and robots.
        seed: of noise and phases on paths.
        jobs: threads; the result does not depend on it.
        progress: is told what is measured.

    Raises:
        FmuError: the FMU cannot be used, or failed.
    """
    fmu = MotorFmu(motor_fmu)
    configs = {
        name: with_motor(find_preset(name).config(), motor_fmu)
        for name in {p.preset for p in SPEEDS}
    }
    driving = calibrated(configs[PAPER], motor_fmu, progress)
    compared = [p for p in SPEEDS if p.preset == "icra2006" and p.value is not None]
    driven = [(path, dithered) for path in (*PATHS, None) for dithered in (True, False)]

    def speed(point: PublishedSpeed) -> Any:
        config = configs[point.preset]
        return measured_speed(config, fmu, point.manoeuvre, point.omega_rad_s, effort.phases)

    def slopes(point: PublishedSpeed) -> Any:
        return sensitivities(configs[point.preset], fmu, point.omega_rad_s, effort.phases)

    def ends(path: PublishedPath | None, dithered: bool) -> Any:
        legs, meant = _meant(path)
        found = drive_by_the_clock(driving, fmu, legs, effort.robots, seed, dithered=dithered)
        return (found - meant).tolist()

    tasks: list[tuple[CoSimConfig, tuple[Any, ...], Callable[[], Any]]] = [
        *((configs[p.preset], (p, effort.phases), lambda p=p: speed(p)) for p in SPEEDS),
        *(
            (configs[p.preset], ("slopes", p, effort.phases), lambda p=p: slopes(p))
            for p in compared
        ),
        *((driving, (p, d, effort.robots, seed), lambda p=p, d=d: ends(p, d)) for p, d in driven),
    ]
    code = code_digest(__name__)
    found: list[Any] = []
    with ThreadPoolExecutor(jobs) as threads:
        kept = (
            threads.submit(_kept, digest_of(config, *key, motor_fmu, code), make)
            for config, key, make in tasks
        )
        try:
            for result in list(kept):
                found.append(result.result())
                progress("measuring", len(found), len(tasks))
        except BaseException:
            threads.shutdown(cancel_futures=True)
            raise
    speeds, rest = found[: len(SPEEDS)], found[len(SPEEDS) :]
    return Validation(
        [(p, MeasuredSpeed(*values)) for p, values in zip(SPEEDS, speeds, strict=True)],
        [
            Sensitivity(p, values, closed_form(configs[p.preset], p.omega_rad_s))
            for p, values in zip(compared, rest, strict=False)
        ],
        [
            DrivenPath(path, dithered, values)
            for (path, dithered), values in zip(driven, rest[len(compared) :], strict=True)
        ],
    )


def _meant(path: PublishedPath | None) -> tuple[list[Leg], np.ndarray]:
    """Parts of a path, and displacement and turned angle at its end."""
    if path is not None:
        return polygon(path.sides, 1e-3 * path.side_mm), np.array([0.0, 0.0, 2.0 * math.pi])
    return sideways(V_STEPS, V_LEG_M, V_HALF_RAD), np.array([0.0, v_meant_m(), 0.0])


def v_meant_m() -> float:
    """Sideways displacement that the V-shaped steps are meant to give, in m."""
    return V_STEPS * 2.0 * V_LEG_M * math.sin(V_HALF_RAD)


def _kept(digest: str, make: Callable[[], Any]) -> Any:
    path = cache_dir("validation") / f"{digest}.json"
    return cached(
        path,
        lambda file: read_json(file, _FILE),
        lambda: msgspec.to_builtins(make()),
        lambda value, file: write_json(file, value),
    )

"""Measurements that are compared with published machines, each kept as it ends."""

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np

from cosim.base.jobs import JobKind, Workers, run
from cosim.base.progress import Progress, silent
from cosim.base.provenance import digest_of
from cosim.base.reading import Kind, read_json
from cosim.base.storage import cache_dir, is_intact, require_cache, write_checksum, write_json
from cosim.calibration.cache import calibrated
from cosim.coupling.fmu import MotorFmu
from cosim.coupling.parameters import with_motor
from cosim.machine.validation.driving import (
    V_HALF_RAD,
    V_LEG_M,
    V_STEPS,
    Leg,
    MeasuredSpeed,
    closed_form,
    drive_by_the_clock,
    measured_sensitivities,
    measured_speed,
    polygon,
    sideways,
    v_meant_m,
)
from cosim.machine.validation.published import PATHS, SPEEDS, PublishedPath, PublishedSpeed
from cosim.machine.validation.report import ValidationReport, report_of
from cosim.model.config import CoSimConfig
from cosim.model.preset import PAPER, find_preset
from fmus.build import identity_of_fmu

VERSION = 1  # of measurements: raise it when their bits change

What = Literal["speed", "slopes", "ends"]
_FILE = Kind("kept measurement", "measure it again")


class Effort(NamedTuple):
    """Amount of simulation: phases between the motors, and robots that drive each path."""

    phases: int = 8
    robots: int = 8


QUICK = Effort(2, 2)


@dataclass(frozen=True)
class Measurement:
    """A measurement as a job.

    Attributes:
        what: a speed, its slopes, or the ends of a path by the clock.
        config: of the co-simulation.
        fmu: motor FMU file.
        of: what was published; None of the V-shaped steps.
        count: phases between the motors, or robots.
        dithered: whether motors have the steering's dither, on a path.
        seed: of noise and phases, on a path.
    """

    what: What
    config: CoSimConfig
    fmu: Path
    of: PublishedSpeed | PublishedPath | None
    count: int
    dithered: bool = False
    seed: int = 0

    @cached_property
    def digest(self) -> str:
        """Hash (16 hex digits) of what decides the result."""
        parts = self.what, self.config.unsourced, self.of, self.count, self.dithered, self.seed
        return digest_of(*parts, identity_of_fmu(self.fmu), VERSION)

    @property
    def key(self) -> tuple[str, None]:
        """Equal for equal measurements, each of which has one result."""
        return self.digest, None

    @property
    def path(self) -> Path:
        """File of the cache that keeps the result."""
        return cache_dir("validation") / f"{self.digest}.json"

    def measure(self) -> Any:
        """Return the result as JSON has it."""
        of, fmu = self.of, MotorFmu(self.fmu)
        if not isinstance(of, PublishedSpeed):
            legs, meant = _meant(of)
            kind = {"dithered": self.dithered}
            ends = drive_by_the_clock(self.config, fmu, legs, self.count, self.seed, **kind)
            return (ends - meant).tolist()
        if self.what == "slopes":
            return measured_sensitivities(self.config, fmu, of.omega_rad_s, self.count)
        found = measured_speed(self.config, fmu, of.manoeuvre, of.omega_rad_s, self.count)
        return msgspec.to_builtins(found)


class _Cache:
    """Results in the cache, a file each."""

    def find(self, job: Measurement) -> Any:
        """Return the result of a measurement, None if it is missing or damaged."""
        if is_intact(job.path):
            return read_json(job.path, _FILE)
        require_cache(job.path.parent)  # before anything is measured
        return None

    def keep(self, job: Measurement, row: Any) -> None:
        """Keep the result of a measurement."""
        write_json(job.path, row)
        write_checksum(job.path)


def _measured(
    jobs: Sequence[Measurement], threads: int, may_begin: Callable[[], bool]
) -> Iterator[tuple[Measurement, Any]]:
    with ThreadPoolExecutor(threads) as pool:
        begun = {pool.submit(job.measure): job for job in jobs if may_begin()}
        try:
            for ended in as_completed(begun):
                yield begun[ended], ended.result()
        finally:
            pool.shutdown(cancel_futures=True)


MEASUREMENTS: JobKind[Measurement, Any] = JobKind(_measured, lambda job: job.key)


def validate(
    motor_fmu: Path,
    effort: Effort = Effort(),  # noqa: B008 - a constant
    seed: int = 0,
    where: Workers = Workers(),  # noqa: B008 - a constant
    progress: Progress = silent,
) -> ValidationReport:
    """Measure results that are missing in the cache, and compare them with published ones.

    Args:
        motor_fmu: of every motor.
        effort: phases and robots.
        seed: of noise and phases on paths.
        where: backend and number of workers; the result does not depend on it.
        progress: receives how much is measured.

    Raises:
        FmuError: the FMU cannot be used, or failed.
    """
    configs = {
        name: with_motor(find_preset(name).config(), motor_fmu)
        for name in {p.preset for p in SPEEDS}
    }
    driving = calibrated(configs[PAPER], motor_fmu, progress)
    compared = [p for p in SPEEDS if p.preset == "icra2006" and p.value is not None]

    def measurements(what: What, points: Sequence[PublishedSpeed]) -> dict[Any, Measurement]:
        return {
            p: Measurement(what, configs[p.preset], motor_fmu, p, effort.phases) for p in points
        }

    speeds, slopes = measurements("speed", SPEEDS), measurements("slopes", compared)
    paths = {
        (path, dithered): Measurement(
            "ends", driving, motor_fmu, path, effort.robots, dithered, seed
        )
        for path in (*PATHS, None)
        for dithered in (True, False)
    }
    store, jobs = _Cache(), [*speeds.values(), *slopes.values(), *paths.values()]
    for _ in run(jobs, store, MEASUREMENTS, where, progress=progress, task="measuring"):
        pass
    return report_of(
        [(p, MeasuredSpeed(*store.find(job))) for p, job in speeds.items()],
        [(p, store.find(job), closed_form(job.config, p.omega_rad_s)) for p, job in slopes.items()],
        [(*which, store.find(job)) for which, job in paths.items()],
        effort.phases,
        seed,
    )


def _meant(path: PublishedPath | None) -> tuple[list[Leg], np.ndarray]:
    """Parts of a path, and displacement and turned angle at its end."""
    if path is not None:
        return polygon(path.sides, 1e-3 * path.side_mm), np.array([0.0, 0.0, 2.0 * math.pi])
    return sideways(V_STEPS, V_LEG_M, V_HALF_RAD), np.array([0.0, v_meant_m(), 0.0])

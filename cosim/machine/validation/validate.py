"""Measurements that are compared with published machines, each kept as it ends."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from cosim.base.jobs import JobKind, Workers, run
from cosim.base.progress import Progress, silent
from cosim.base.provenance import digest_of
from cosim.base.reading import Kind, read_json
from cosim.base.storage import cache_dir, is_intact, require_cache, write_checksum, write_json
from cosim.calibration.measuring import calibrated
from cosim.fmi.motor import MotorFmu, with_motor
from cosim.machine.validation.driving import (
    MeasuredSpeed,
    closed_form,
    drive_by_the_clock,
    measured_sensitivities,
    measured_speed,
)
from cosim.machine.validation.droplets import (
    SHOWN,
    VARIANTS,
    Motion,
    measured_row,
    robot_rows,
    simulated,
    variant_row,
)
from cosim.machine.validation.published import PATHS, SPEEDS
from cosim.machine.validation.report import ValidationReport, report_of
from cosim.model.config import CoSimConfig
from cosim.model.preset import PAPER, find_preset
from fmus.build import identity_of_fmu

VERSION = 3  # of measurements: raise it when their bits change

_FILE = Kind("kept measurement", "measure it again")


FULL, QUICK = 8, 2  # phases between the motors of each speed, and robots that drive each path


@dataclass(frozen=True)
class Measurement:
    """A measurement as a job."""

    measure: Callable[..., Any]  # of the configuration, the FMU and the arguments
    config: CoSimConfig
    fmu: Path
    arguments: tuple[Any, ...]

    @property
    def key(self) -> tuple[str, None]:
        """Hash of what decides the result: equal measurements have one."""
        parts = self.measure.__name__, self.config.unsourced, self.arguments
        return digest_of(*parts, identity_of_fmu(self.fmu), VERSION), None

    def result(self) -> Any:
        """Return the result as JSON has it."""
        found = self.measure(self.config, MotorFmu(self.fmu), *self.arguments)
        return msgspec.to_builtins(found, enc_hook=np.ndarray.tolist)


class _Cache:
    """Results in the cache, a file each."""

    def find(self, job: Measurement) -> Any:
        path = self._path(job)
        if is_intact(path):
            return read_json(path, _FILE)
        require_cache(path.parent)  # before anything is measured
        return None

    def keep(self, job: Measurement, row: Any) -> None:
        write_json(self._path(job), row)
        write_checksum(self._path(job))

    def _path(self, job: Measurement) -> Path:
        return cache_dir("validation") / f"{job.key[0]}.json"


def _measured(
    jobs: Sequence[Measurement], threads: int, may_begin: Callable[[], bool]
) -> Iterator[tuple[Measurement, Any]]:
    with ThreadPoolExecutor(threads) as pool:
        begun = {pool.submit(job.result): job for job in jobs if may_begin()}
        try:
            for ended in as_completed(begun):
                yield begun[ended], ended.result()
        finally:
            pool.shutdown(cancel_futures=True)


MEASUREMENTS: JobKind[Measurement, Any] = JobKind(_measured, lambda job: job.key)


def validate(
    motor_fmu: Path,
    count: int = FULL,
    seed: int = 0,
    where: Workers = Workers(),  # noqa: B008 - a constant
    progress: Progress = silent,
) -> ValidationReport:
    """Measure results that are missing in the cache, and compare them with published ones."""
    configs = {
        name: with_motor(find_preset(name).config(), motor_fmu)
        for name in {p.preset for p in SPEEDS}
    }
    driving = calibrated(configs[PAPER], motor_fmu, progress)
    speeds = {
        p: Measurement(
            measured_speed, configs[p.preset], motor_fmu, (p.manoeuvre, p.omega_rad_s, count)
        )
        for p in SPEEDS
    }
    slopes = {
        p: replace(job, measure=measured_sensitivities, arguments=(p.omega_rad_s, count))
        for p, job in speeds.items()
        if p.preset == "icra2006" and p.value is not None
    }
    paths = {
        (path, dithered): Measurement(
            drive_by_the_clock, driving, motor_fmu, (path.legs, count, seed, dithered)
        )
        for path in PATHS
        for dithered in (True, False)
    }
    droplet = find_preset("droplet").config()
    variants = {
        variant: Measurement(simulated, droplet, motor_fmu, (variant,))
        for variant in (VARIANTS if count >= FULL else (SHOWN,))
    }
    jobs = [*speeds.values(), *slopes.values(), *paths.values(), *variants.values()]
    store = _Cache()
    for _ in run(jobs, store, MEASUREMENTS, where, progress=progress, task="measuring"):
        pass
    motions = {v: Motion(*map(np.array, store.find(job))) for v, job in variants.items()}
    report = report_of(
        {p: MeasuredSpeed(*store.find(job)) for p, job in speeds.items()},
        {p: (store.find(job), closed_form(job.config, p.omega_rad_s)) for p, job in slopes.items()},
        [(*which, store.find(job)) for which, job in paths.items()],
        count,
        seed,
    )
    rows = measured_row(), *(variant_row(*pair) for pair in motions.items())
    robots = tuple(robot_rows(motions[SHOWN]))
    return msgspec.structs.replace(report, droplets=rows, robots=robots)

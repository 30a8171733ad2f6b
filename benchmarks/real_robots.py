"""Compare simulated robots with published real ones, each with its preset.

Twenty real Droplets, robot by robot; speeds at their motor speeds, steps per turn, turning, closed
paths driven by the clock, V-shaped steps, how speeds depend on parameters, and robots on elastic
legs. Measurements are kept in the cache: the same command resumes.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from benchmarks.published.driving import (
    MeasuredSpeed,
    closed_form,
    drive_by_the_clock,
    measured_sensitivities,
    measured_speed,
)
from benchmarks.published.droplets import (
    SHOWN,
    SMALL_UNIT_MM,
    UNIT_MM,
    VARIANTS,
    Motion,
    draw,
    measured_row,
    robot_rows,
    simulated,
    variant_row,
)
from benchmarks.published.legs import ROBOTS, legged_rows, motion
from benchmarks.published.points import PATHS, SPEEDS
from benchmarks.published.rows import Row, rows_of
from cosim.base.command import Checked, File, Jobs, Seed
from cosim.base.jobs import Workers
from cosim.base.plotting import save_figure
from cosim.base.provenance import digest_of
from cosim.base.reading import Kind, read_json
from cosim.base.storage import cache_dir, is_intact, require_cache, write_checksum, write_json
from cosim.calibration.measuring import calibrated
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig
from cosim.model.preset import PAPER, find_preset
from fmus.build import cached_fmu, identity_of_fmu

VERSION = 4  # of measurements: raise it when their bits change
FULL, QUICK = 8, 2  # phases between the motors of each speed, and robots that drive each path
_FILE = Kind("kept measurement", "measure it again")


@dataclass(frozen=True, kw_only=True)
class Options(Checked):
    quick: bool = False
    """Short trial: two phases, two robots a path and one variant of the Droplet."""
    seed: Seed = 0
    jobs: Jobs = -1
    figure: File = Path("runs/droplets.png")
    """Where the figure of the Droplets is written."""


@dataclass(frozen=True)
class Measurement:
    """A measurement as a job."""

    measure: Callable[..., Any]  # of the configuration, the FMU and the arguments
    config: CoSimConfig
    arguments: tuple[Any, ...]

    @property
    def key(self) -> str:
        """Hash of what decides the result: equal measurements have one."""
        parts = self.measure.__name__, self.config.unsourced, self.arguments
        return digest_of(*parts, identity_of_fmu(cached_fmu()), VERSION)

    def result(self) -> Any:
        """Return the result as JSON has it."""
        found = self.measure(self.config, MotorFmu(cached_fmu()), *self.arguments)
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
        return cache_dir("real-robots") / f"{job.key}.json"


def make_missing(jobs: list[Measurement], cache: _Cache, threads: int) -> None:
    """Make the measurements that the cache lacks, and keep each as it ends."""
    missing = {job.key: job for job in jobs if cache.find(job) is None}
    with ThreadPoolExecutor(threads) as pool:
        begun = {pool.submit(job.result): job for job in missing.values()}
        try:
            for ended in as_completed(begun):
                cache.keep(begun[ended], ended.result())
        finally:
            pool.shutdown(cancel_futures=True)


def measure(options: Options) -> dict[str, list[Row]]:
    count = QUICK if options.quick else FULL
    configs = {name: find_preset(name).config() for name in {p.preset for p in SPEEDS}}
    driving = calibrated(configs[PAPER], cached_fmu())
    speeds = {
        p: Measurement(measured_speed, configs[p.preset], (p.manoeuvre, p.omega_rad_s, count))
        for p in SPEEDS
    }
    slopes = {
        p: replace(job, measure=measured_sensitivities, arguments=(p.omega_rad_s, count))
        for p, job in speeds.items()
        if p.preset == "icra2006" and p.value is not None
    }
    paths = {
        (path, dithered): Measurement(
            drive_by_the_clock, driving, (path.legs, count, options.seed, dithered)
        )
        for path in PATHS
        for dithered in (True, False)
    }
    droplet = find_preset("droplet").config()
    variants = {
        variant: Measurement(simulated, droplet, (variant.mu, variant.spin_up_s))
        for variant in ((SHOWN,) if options.quick else VARIANTS)
    }
    legged = {
        robot: Measurement(motion, find_preset(robot.preset).config(), (robot.omega_rad_s,))
        for robot in ROBOTS
    }
    jobs = [job for of in (speeds, slopes, paths, variants, legged) for job in of.values()]
    store = _Cache()
    make_missing(jobs, store, Workers(jobs=options.jobs).count)
    motions = {v: Motion(*map(np.array, store.find(job))) for v, job in variants.items()}
    robots = robot_rows(motions[SHOWN])
    options.figure.parent.mkdir(parents=True, exist_ok=True)
    save_figure(draw(robots), options.figure, dpi=110)
    return {
        "droplets": [
            *map(measured_row, (UNIT_MM, SMALL_UNIT_MM)),
            *(variant_row(*pair) for pair in motions.items()),
        ],
        "robots": robots,
        "legs": legged_rows({robot: store.find(job) for robot, job in legged.items()}),
        **rows_of(
            {p: MeasuredSpeed(*store.find(job)) for p, job in speeds.items()},
            {
                p: (store.find(job), closed_form(job.config, p.omega_rad_s))
                for p, job in slopes.items()
            },
            [(*which, store.find(job)) for which, job in paths.items()],
        ),
    }

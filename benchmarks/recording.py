"""Measure the size of recordings, their cost and the time to open them, for each level of --record.

On two robots that drive with noise: the cost of recording as the ratio of short rounds with and
without it in turn, the best of each counting; sizes and opening times on an episode of 60 s per
level. A recording is opened twice: as tables in Python, and in the Rerun viewer, headless with
software Vulkan, from asking it to open the file until it has loaded.
"""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from rerun.chunk import RrdReader

from analysis.viewer import screenshot
from benchmarks.timing import times_s
from cosim.base.command import Checked, Count, Seconds
from cosim.base.errors import UserError
from cosim.coupling.rl_step import Decision, Step
from cosim.model.config import CoSimConfig
from cosim.model.params import TIMING
from cosim.model.scenario import Scenario
from cosim.recording.episode import EpisodeRecorder
from cosim.recording.series import DETAILS, Level
from cosim.simulation.batch import Batch
from fmus.build import cached_fmu

NORTH, SOUTH = 2, 6
NOTHING = np.full((2, 3), np.nan)
SCENARIO = Scenario("pair", "", ((7, 27), (22, 27)), (((7, 2),), ((22, 2),)))


@dataclass(frozen=True, kw_only=True)
class Options(Checked):
    levels: tuple[Literal["summary", "default", "full"], ...] = ("summary", "default", "full")
    """Levels to measure."""
    rounds: Count = 7
    """Rounds of each kind in the measurement of cost; the best counts."""
    round_s: Seconds = 60.0
    """Simulated time of a round in s."""
    episode_s: Seconds = 60.0
    """Simulated time of the episodes with measured sizes and opening times, in s."""
    viewer: bool = True
    """Whether to open recordings in the viewer; --no-viewer where there is no Vulkan."""


def system_of(level: Level, driver: str = "compiled") -> Batch:
    """Two robots that drive north and south, with the bursts of a level."""
    timing = TIMING._replace(burst_s=DETAILS[level].burst_s, episode_limit_s=1e9)
    system = Batch(cached_fmu(), CoSimConfig(timing=timing), 2, 1, driver)
    system.compile()
    return system


def drive(system: Batch, time_s: float, write: Callable[[Step], None]) -> None:
    """One episode of the given simulated time; every step is shown to `write`."""
    starts = tuple(cells[0] for cells in SCENARIO.starts)
    system.begin(0, SCENARIO, starts, np.random.SeedSequence(0))
    steps = round(time_s / TIMING.rl_step_s)
    for number in range(steps):
        write(system.advance({0: np.full(2, NORTH if 2 * number < steps else SOUTH)})[0])
    system.close()


def recorded(system: Batch, path: Path, time_s: float, level: Level) -> None:
    """Simulate with a recording."""
    values = np.zeros((2, 8))
    with EpisodeRecorder(
        path, SCENARIO, system.config, "benchmark", {"seed": 0}, level=level
    ) as recorder:
        drive(
            system,
            time_s,
            lambda step: recorder.write(step, Decision(step.action, values), NOTHING),
        )


def overheads(
    level: Level, rounds: int, round_s: float, path: Path, driver: str = "compiled"
) -> np.ndarray:
    """Additional wall-clock and processor time of recording, as shares.

    Every round has systems of its own: where their arrays lie in memory makes one up to a tenth
    faster than another.
    """
    with_it, without = [], []
    for _ in range(rounds):  # in turn, so that both meet the same machine
        system = system_of(level, driver)
        unrecorded = system_of("summary", driver)  # which has no bursts
        without.append(times_s(partial(drive, unrecorded, round_s, lambda _: None)))
        with_it.append(times_s(partial(recorded, system, path, round_s, level)))
    return np.min(with_it, axis=0) / np.min(without, axis=0) - 1.0


def read(path: Path) -> None:
    """Decode every table of a recording."""
    for chunk in RrdReader(str(path)).stream():
        chunk.to_record_batch()


def measure_level(level: Level, options: Options, folder: Path) -> dict[str, float | None]:
    """Size of the episode's recording, additional time as a share, best times to read and open."""
    path = folder / f"{level}.rrd"
    overhead, overhead_cpu = overheads(level, options.rounds, options.round_s, path)
    recorded(system_of(level), path, options.episode_s, level)
    picture, times = folder / "picture.png", range(3 if options.viewer else 0)
    return {
        "megabytes": path.stat().st_size / 1e6,
        "overhead": float(overhead),
        "overhead_cpu": float(overhead_cpu),
        "read_s": min(float(times_s(lambda: read(path))[0]) for _ in range(3)),
        # of the viewer, if it was asked
        "open_s": min((screenshot(path, picture).load_s for _ in times), default=None),
    }


def measure(options: Options) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        try:
            return {level: measure_level(level, options, Path(folder)) for level in options.levels}
        except UserError as error:
            raise UserError(f"{error}; or measure without it: --no-viewer") from error

"""Many episodes of one configuration: seeds, threads, recordings, results.

Episodes are independent: each has its own FMU instances and its own seed, compiled code runs
without the interpreter lock, and so the results do not depend on the number of threads.
"""

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from agent.evaluation.rollout import EpisodeResult, roll_out
from agent.training.policy import Policy
from cosim.base.config import CoSimConfig
from cosim.base.scenario import Scenario
from cosim.navigation.episode import CoSimulation, Step
from cosim.navigation.observing import draw_starts
from cosim.recording.episode import EpisodeRecorder
from cosim.recording.levels import Level


@dataclass(frozen=True)
class Batch:
    """What the episodes of a run have in common.

    Attributes:
        scenario, config, driver: of every co-simulation.
        fmu: motor FMU file.
        seed: episode k draws from the seed sequence (seed, k).
        policy: acts, and names the process whose rewards are recorded.
        out: output folder; recordings go to `episodes/` in it.
        facts: what identifies the run, for recordings.
        viewer: address of a running viewer that is sent what is recorded, if any.
    """

    scenario: Scenario
    fmu: Path
    config: CoSimConfig
    driver: str
    seed: int
    policy: Policy
    out: Path
    facts: dict[str, Any]
    viewer: str | None = None

    def run(
        self,
        episodes: Iterable[int],
        jobs: int,
        record: Level | Literal["none"],
        console: Console,
    ) -> Iterator[EpisodeResult]:
        """Results in the order of `episodes`, which run in `jobs` threads.

        On an interrupt or an error every running episode ends after its RL step and completes its
        recording.

        Raises:
            UserError: of an FMU or a recording.
        """
        stop = threading.Event()
        columns = (
            TextColumn("[progress.description]{task.description}"),
            BarColumn(),
            TextColumn("{task.fields[state]}"),
            TimeElapsedColumn(),
        )
        with (
            Progress(*columns, console=console, disable=not console.is_terminal) as bar,
            ThreadPoolExecutor(jobs) as threads,
        ):

            def run_one(episode: int) -> EpisodeResult:
                task = bar.add_task(f"episode {episode}", total=None, state="")
                result = self._episode(
                    episode, record, stop, lambda state: bar.update(task, state=state)
                )
                bar.update(task, total=1, completed=1)
                return result

            try:
                yield from threads.map(run_one, episodes)
            except BaseException:
                stop.set()
                threads.shutdown(cancel_futures=True)
                raise

    def _episode(
        self,
        episode: int,
        record: Level | Literal["none"],
        stop: threading.Event,
        show: Callable[[str], None],
    ) -> EpisodeResult:
        start_seed, noise_seed = np.random.SeedSequence(self.seed, spawn_key=(episode,)).spawn(2)
        starts = draw_starts(self.scenario, np.random.default_rng(start_seed))
        path = self.out / "episodes" / f"ep_{episode:03d}.rrd"
        system = CoSimulation(self.scenario, self.fmu, self.config, self.driver)
        began = time.perf_counter()

        def watch(step: Step) -> None:
            if stop.is_set():
                raise KeyboardInterrupt
            factor = system.time_s / (time.perf_counter() - began)
            show(f"{system.time_s:.0f} s simulated, {factor:.1f} × real time {step.outcome}")

        if record == "none":
            return roll_out(system, self.policy, starts, noise_seed, None, watch)
        recorder = EpisodeRecorder(
            path,
            self.scenario,
            self.config,
            f"{self.scenario.name}-{self.seed}-{episode}",
            self.facts | {"episode": episode, "starts": starts},
            level=record,
            viewer=self.viewer,
            policies=self.policy.maps(),
        )
        with recorder:
            result = roll_out(system, self.policy, starts, noise_seed, recorder, watch)
        return replace(result, recording=str(path.relative_to(self.out)))

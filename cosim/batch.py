"""Many episodes of one configuration: seeds, threads, recordings, results.

Episodes are independent: each has its own FMU instances and its own seed, compiled code runs
without the interpreter lock, and so the results do not depend on the number of threads.
"""

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from agent.cosim_reward import step_reward
from agent.policy import Policy
from cosim.config import CoSimConfig
from cosim.episode import CoSimulation, Step, run_episode
from cosim.episode_recording import EpisodeRecorder
from cosim.observing import draw_starts
from cosim.scenario import Cell, Scenario


@dataclass(frozen=True)
class EpisodeResult:
    """One episode as `summary.json` lists it.

    Attributes:
        outcome: success, collision, out_of_board or timeout.
        path_length_cm: mean over the robots.
        sim_time_s: simulated time.
        realtime_factor: simulated time over wall-clock time, recording included.
        recording: its path relative to the output folder, None if there is none.
        starts: start cell of each robot.
        path_length_cm_by_robot: of each robot.
        contact_time_s: time in which any two robots touched.
    """

    outcome: str
    path_length_cm: float
    sim_time_s: float
    realtime_factor: float
    recording: str | None
    starts: tuple[Cell, ...]
    path_length_cm_by_robot: tuple[float, ...]
    contact_time_s: float


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
    """

    scenario: Scenario
    fmu: Path
    config: CoSimConfig
    driver: str
    seed: int
    policy: Policy
    out: Path
    facts: dict[str, Any]

    def run(
        self, episodes: Iterable[int], jobs: int, record: bool, console: Console
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
        self, episode: int, record: bool, stop: threading.Event, show: Callable[[str], None]
    ) -> EpisodeResult:
        start_seed, noise_seed = np.random.SeedSequence(self.seed, spawn_key=(episode,)).spawn(2)
        starts = draw_starts(self.scenario, np.random.default_rng(start_seed))
        path = self.out / "episodes" / f"ep_{episode:03d}.rrd"
        system = CoSimulation(self.scenario, self.fmu, self.config, self.driver)
        began = time.perf_counter()
        with ExitStack() as stack:
            stack.callback(system.close)
            recorder = None
            if record:
                identity = f"{self.scenario.name}-{self.seed}-{episode}"
                facts = self.facts | {"episode": episode, "starts": starts}
                recorder = stack.enter_context(
                    EpisodeRecorder(path, self.scenario, self.config, identity, facts)
                )

            def observe(step: Step) -> None:
                if stop.is_set():
                    raise KeyboardInterrupt
                if recorder is not None:
                    reward = step_reward(self.policy.process, step, system.arrived)
                    recorder.write(step, self.policy.q_values(step.before), reward)
                factor = system.time_s / (time.perf_counter() - began)
                show(f"{system.time_s:.0f} s simulated, {factor:.1f} × real time {step.outcome}")

            run_episode(system, self.policy, starts, noise_seed, observe)
        wall_s = time.perf_counter() - began
        by_robot = tuple(float(round(100.0 * length, 6)) for length in system.path_length_m)
        return EpisodeResult(
            outcome=system.outcome,
            path_length_cm=float(np.mean(by_robot)),
            sim_time_s=round(system.time_s, 9),
            realtime_factor=system.time_s / wall_s,
            recording=str(path.relative_to(self.out)) if record else None,
            starts=starts,
            path_length_cm_by_robot=by_robot,
            contact_time_s=round(system.contact_time_s, 9),
        )

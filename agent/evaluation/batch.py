"""Many episodes of one configuration: seeds, threads, recordings, results.

Episodes are independent: each has its own FMU instances and its own seed, compiled code runs
without the interpreter lock, and so the results do not depend on the number of threads.
"""

import threading
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec

from agent.training.policy import Policy
from cosim.base.config import CoSimConfig
from cosim.base.progress import Progress, silent
from cosim.base.scenario import Scenario
from cosim.base.storage import write_json
from cosim.navigation.batch import CoSimulation
from cosim.navigation.episode import Step
from cosim.recording.episode import EpisodeRecorder
from cosim.recording.levels import Level
from cosim.simulation import EpisodeResult, draw_episode, simulate_episode


class RunFacts(msgspec.Struct, frozen=True, kw_only=True):
    """What identifies a run, for summaries and recordings; the same for equal runs.

    Attributes:
        scenario, title: of the scenario.
        seed: of start cells and speed noise.
        train_seed: of the policy; a list, the experiment's first, if it was spawned from that.
        driver: of the co-simulation.
        motor_fmu: name of the file.
        method: by which the policy was trained, "other" for readings of somebody's own.
        versions: of this package, Python and libraries.
    """

    scenario: str
    title: str
    seed: int
    train_seed: Any
    driver: str
    motor_fmu: str
    method: str
    versions: dict[str, str]

    def builtins(self) -> dict[str, Any]:
        """The facts by name, as the properties of a recording have them."""
        return msgspec.structs.asdict(self)


class RunSummary(RunFacts, frozen=True, kw_only=True):
    """The content of `summary.json`: the facts, parameters by name, and every episode."""

    parameters: dict[str, float | bool | str]
    episodes: tuple[EpisodeResult, ...]
    schema_version: int = 1


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
    facts: RunFacts
    viewer: str | None = None

    def run(
        self,
        episodes: Iterable[int],
        jobs: int,
        record: Level | Literal["none"],
        progress: Progress = silent,
    ) -> Iterator[EpisodeResult]:
        """Results in the order of `episodes`, which run in `jobs` threads, and `summary.json`.

        On an interrupt or an error every running episode ends after its RL step and completes its
        recording.

        Raises:
            UserError: of an FMU or a recording.
        """
        stop = threading.Event()
        with ThreadPoolExecutor(jobs) as threads:

            def run_one(episode: int) -> EpisodeResult:
                return self._episode(episode, record, stop, progress)

            results: list[EpisodeResult] = []
            try:
                for result in threads.map(run_one, episodes):
                    results.append(result)
                    self._write_summary(results)
                    yield result
            except BaseException:
                stop.set()
                threads.shutdown(cancel_futures=True)
                raise

    def _write_summary(self, results: list[EpisodeResult]) -> None:
        parameters = {name: row["value"] for name, row in self.config.table().items()}
        facts = self.facts.builtins()
        summary = RunSummary(**facts, parameters=parameters, episodes=tuple(results))
        write_json(self.out / "summary.json", summary)

    def _episode(
        self,
        episode: int,
        record: Level | Literal["none"],
        stop: threading.Event,
        progress: Progress,
    ) -> EpisodeResult:
        starts, noise_seed = draw_episode(self.scenario, self.seed, episode)
        path = self.out / "episodes" / f"ep_{episode:03d}.rrd"
        system = CoSimulation(self.scenario, self.fmu, self.config, self.driver)
        began = time.perf_counter()

        def watch(step: Step) -> None:
            if stop.is_set():
                raise KeyboardInterrupt
            factor = system.time_s / (time.perf_counter() - began)
            state = f"{system.time_s:.0f} s, {factor:.1f} × real time {step.outcome}"
            total = system.time_s if step.outcome else self.config.timing.episode_limit_s
            progress(f"episode {episode}", system.time_s, total, state)

        if record == "none":
            return simulate_episode(system, self.policy, starts, noise_seed, None, watch)
        recorder = EpisodeRecorder(
            path,
            self.scenario,
            self.config,
            f"{self.scenario.name}-{self.seed}-{episode}",
            self.facts.builtins() | {"episode": episode, "starts": starts},
            level=record,
            viewer=self.viewer,
            policies=self.policy.maps(),
        )
        with recorder:
            result = simulate_episode(system, self.policy, starts, noise_seed, recorder, watch)
        return msgspec.structs.replace(result, recording=str(path.relative_to(self.out)))

"""A series of episodes of one configuration: seeds, recordings, results."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec
from msgspec import to_builtins
from msgspec.structs import asdict

from agent.mdp.greedy import GreedyPolicy
from agent.policies import load_policy
from cosim.base.arguments import ConfigError
from cosim.base.progress import Progress, silent
from cosim.base.provenance import digest_of
from cosim.base.reading import Kind, read_json
from cosim.base.storage import write_json
from cosim.coupling.rl_step import Step
from cosim.model.config import CoSimConfig
from cosim.model.scenario import Scenario
from cosim.recording.episode import EpisodeRecorder
from cosim.recording.series import Level
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.result import EpisodeResult
from cosim.simulation.simulate import draw_episode
from cosim.simulation.tasks import Task, recorder_of, simulate_tasks

_SUMMARY = Kind("summary of a run", "choose another --out, or remove it")


class RunFacts(msgspec.Struct, frozen=True, kw_only=True):
    """Identity of a run, for summaries and recordings; equal runs have the same.

    Attributes:
        scenario, title: of the scenario.
        seed: of start cells and speed noise.
        train_seed: of the policy; a list, the experiment's first, if it was spawned from that.
        driver: of the co-simulation.
        motor_fmu, motor_fmu_digest: name of the file, and identity of the FMU.
        method: by which the policy was trained, "other" for interpretations of the user's own.
        versions: of this package, Python and libraries.
    """

    scenario: str
    title: str
    seed: int
    train_seed: Any
    driver: str
    motor_fmu: str
    motor_fmu_digest: str
    method: str
    versions: dict[str, str]


class RunSummary(RunFacts, frozen=True, kw_only=True):
    """The content of `summary.json`: the facts, parameters by name, and every episode."""

    parameters: dict[str, float | bool | str | list[Any]]
    episodes: tuple[EpisodeResult, ...]
    schema_version: int = 1


@dataclass(frozen=True)
class Series:
    """Settings that all episodes of a run share.

    Attributes:
        scenario, config: of every co-simulation.
        fmu: motor FMU file.
        policy: acts, and names the process of the recorded rewards.
        out: output folder; recordings go to `episodes/` in it.
        facts: what identifies the run; episode k draws from the seed sequence (seed, k).
        viewer: address of a running viewer that is sent what is recorded, if any.
        record: how much of every episode is recorded.
        progress: receives the simulated time of every episode.
        sampled: indices of the robots with recorded signals, by default `sampled_of`.
    """

    scenario: Scenario
    fmu: Path
    config: CoSimConfig
    policy: GreedyPolicy
    out: Path
    facts: RunFacts
    viewer: str | None = None
    record: Level | Literal["none"] = "default"
    progress: Progress = silent
    sampled: tuple[int, ...] | None = None

    def run(self, episodes: int, threads: int) -> Iterator[EpisodeResult]:
        """Results of the first episodes, in order, and `summary.json`.

        On an interrupt or an error every running episode ends after its RL step and completes its
        recording.

        Raises:
            UserError: of an FMU or a recording.
        """
        tasks = [self.task(episode) for episode in range(episodes)]
        ended: dict[int, EpisodeResult] = {}
        results: list[EpisodeResult] = []
        for number, result in simulate_tasks(tasks, threads):
            path = self._recording(number).relative_to(self.out)
            name = None if self.record == "none" else str(path)
            ended[number] = msgspec.structs.replace(result, recording=name)
            while len(results) in ended:
                results.append(ended[len(results)])
                write_json(self.out / "summary.json", self._summary(results))
                yield results[-1]

    def refuse_other_results(self) -> None:
        """Refuse a folder with another run's results; those of this one are written again.

        Raises:
            ConfigError: there is another run; the message says how it differs.
        """
        path = self.out / "summary.json"
        if not path.exists():
            return
        was, now = read_json(path, _SUMMARY, RunSummary), self._summary([])
        both = [to_builtins(of.parameters | asdict(of)) for of in (was, now)]
        same = {"parameters", "versions", "episodes"}
        other = [f"{k} = {v}" for k, v in both[0].items() if k not in same and v != both[1].get(k)]
        if digest_of(load_policy(self.out / "policy.npz").config) != digest_of(self.policy.config):
            other.append("another policy")
        if other:
            raise ConfigError(f"{path} is of a run with {', '.join(other[:3])}; {_SUMMARY.fix}")

    def _recording(self, episode: int) -> Path:
        return self.out / "episodes" / f"ep_{episode:03d}.rrd"

    def _summary(self, results: list[EpisodeResult]) -> RunSummary:
        parameters = {name: row["value"] for name, row in self.config.table().items()}
        return RunSummary(**asdict(self.facts), parameters=parameters, episodes=tuple(results))

    def task(self, number: int) -> Task:
        """An episode of the series."""
        starts, noise_seed = draw_episode(self.scenario, self.facts.seed, number)

        def watch(step: Step, episode: RunningEpisode, wall_s: float) -> None:
            factor = episode.time_s / wall_s
            state = f"{episode.time_s:.0f} s, {factor:.1f} × real time {step.outcome}"
            total = episode.time_s if step.outcome else self.config.timing.episode_limit_s
            self.progress(f"episode {number}", episode.time_s, total, state)

        def recorder(episode: RunningEpisode) -> EpisodeRecorder:
            assert self.record != "none"
            return recorder_of(
                episode,
                self._recording(number),
                task.recording_id,
                asdict(self.facts) | {"episode": number, "starts": starts},
                level=self.record,
                viewer=self.viewer,
                policies=self.policy.maps(),
            )

        task = Task(
            self.scenario,
            self.fmu,
            self.config,
            self.policy,
            starts,
            noise_seed,
            None if self.record == "none" else recorder,
            watch,
            self.facts.driver,
            self.sampled,
        )
        return task

"""A series of episodes of one configuration: seeds, recordings, results."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec
from msgspec import to_builtins
from msgspec.structs import asdict

from agent.mdp.greedy import GreedyPolicy
from agent.training.loop import TrainingLog
from agent.training.policy import load_policy
from agent.training.recording import write_training
from cosim.base.arguments import ConfigError
from cosim.base.progress import Progress, silent, under_way
from cosim.base.provenance import digest_of
from cosim.base.reading import Kind, read_json
from cosim.base.storage import write_json
from cosim.coupling.rl_step import Step, sampled_of
from cosim.simulation.batch import chosen_driver
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.options import EpisodeOptions, Setup
from cosim.simulation.result import EpisodeResult
from cosim.simulation.simulate import draw_episode, run_facts
from cosim.simulation.tasks import Record, Task, compile_kernels, simulate_tasks

_SUMMARY = Kind("summary of a run", "choose another --out, or remove it")


class RunFacts(msgspec.Struct, frozen=True, kw_only=True):
    """Identity of a run, for summaries and recordings; equal runs have the same.

    Attributes:
        seed: of start cells and speed noise.
        train_seed: of the policy; a list, the experiment's first, if it was spawned from that.
        method: by which the policy was trained, "other" for interpretations of the user's own.
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
        out: output folder; recordings go to `episodes/` in it.
        options: seed, driver, what is recorded; episode k draws from the seed sequence (seed, k).
        viewer: address of a running viewer that is sent what is recorded, if any.
    """

    setup: Setup
    policy: GreedyPolicy
    out: Path
    options: EpisodeOptions
    viewer: str | None = None
    progress: Progress = silent

    @cached_property
    def facts(self) -> RunFacts:
        """Identity of the run."""
        scenario, config, fmu = self.setup
        seed = self.policy.config.seed
        driver = chosen_driver(self.options.driver, fmu, config)
        return RunFacts(
            **run_facts(scenario, self.options.seed, fmu, driver),
            train_seed=seed.entropy if not seed.spawn_key else [seed.entropy, *seed.spawn_key],
            method=self.policy.config.method,
        )

    def run(
        self, episodes: int, threads: int, log: TrainingLog | None = None
    ) -> list[EpisodeResult]:
        """Keep the policy, simulate, and return the results of the first episodes, in order.

        `summary.json` has those that have ended. On an interrupt or an error every running episode
        ends after its RL step and completes its recording.

        Args:
            log: of the policy's training, which is recorded.
        """
        self._refuse_other_results()
        self.policy.save(self.out / "policy.npz")
        if self.options.record != "none" and log is not None:
            write_training(self.out / "training.rrd", self.policy, log, asdict(self.facts))
        tasks = [self._task(episode) for episode in range(episodes)]
        with under_way(self.progress, "preparing the kernels"):
            compile_kernels(tasks[0], episodes, threads)
        ended: dict[int, EpisodeResult] = {}
        results: list[EpisodeResult] = []
        for number, result in simulate_tasks(tasks, threads):
            path = self._recording(number).relative_to(self.out)
            name = None if self.options.record == "none" else str(path)
            ended[number] = msgspec.structs.replace(result, recording=name)
            while len(results) in ended:
                results.append(ended[len(results)])
                write_json(self.out / "summary.json", self._summary(results))
        return results

    def _refuse_other_results(self) -> None:
        """Refuse a folder with another run's results; those of this one are written again."""
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
        parameters = {name: row["value"] for name, row in self.setup.config.table().items()}
        return RunSummary(**asdict(self.facts), parameters=parameters, episodes=tuple(results))

    def _task(self, number: int) -> Task:
        """An episode of the series."""
        scenario, config, fmu = self.setup
        record = self.options.record
        starts, noise_seed = draw_episode(scenario, self.options.seed, number)

        def watch(step: Step, episode: RunningEpisode, wall_s: float) -> None:
            factor = episode.time_s / wall_s
            state = f"{episode.time_s:.0f} s, {factor:.1f} × real time {step.outcome}"
            total = episode.time_s if step.outcome else config.timing.episode_limit_s
            self.progress(f"episode {number}", episode.time_s, total, state)

        facts = asdict(self.facts) | {"episode": number, "starts": starts}
        place, viewer = self._recording(number), self.viewer
        return Task(
            scenario,
            fmu,
            config,
            self.policy,
            starts,
            noise_seed,
            None if record == "none" else Record(place, facts, record, viewer),
            watch,
            self.facts.driver,
            sampled_of(scenario.robots, self.options.signals),
        )

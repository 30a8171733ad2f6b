"""The episodes of one run: seeds, recordings, results."""

from pathlib import Path
from typing import Any

import msgspec
from msgspec import structs

from agent.mdp.greedy import GreedyPolicy
from agent.training.loop import TrainingLog
from agent.training.policy import load_policy
from agent.training.recording import write_training
from cosim.base.arguments import ConfigError
from cosim.base.progress import Progress, silent, under_way
from cosim.base.reading import Kind, read_json
from cosim.base.storage import write_json
from cosim.coupling.rl_step import Step, sampled_of
from cosim.recording.series import warn_of_size
from cosim.simulation.batch import chosen_driver
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.options import EpisodeOptions, Setup, differing
from cosim.simulation.result import EpisodeResult
from cosim.simulation.simulate import draw_episode, run_facts
from cosim.simulation.tasks import Record, Task, compile_kernels, simulate_tasks

_SUMMARY = Kind("summary of a run", "choose another --out, or remove it")
_NO_FACTS = ("parameters", "differing", "episodes", "schema_version")  # of recordings


class RunSummary(msgspec.Struct, frozen=True, kw_only=True):
    """The content of `summary.json`: what identifies the run, parameters by name, every episode."""

    scenario: str
    title: str
    seed: int  # of start cells and speed noise
    train_seed: Any  # of the policy; a list, the experiment's first, if it was spawned from that
    driver: str
    motor_fmu: str
    motor_fmu_digest: str
    method: str  # of training, "other" for interpretations of the user's own
    versions: dict[str, str]
    parameters: dict[str, float | bool | str | list[Any]]
    differing: dict[str, Any] = {}  # those that are not the default, with unit and source
    episodes: tuple[EpisodeResult, ...] = ()
    schema_version: int = 1


def run_episodes(
    setup: Setup,
    policy: GreedyPolicy,
    out: Path,
    options: EpisodeOptions,
    *,
    episodes: int,
    threads: int,
    log: TrainingLog | None = None,
    viewer: str | None = None,
    progress: Progress = silent,
) -> list[EpisodeResult]:
    """Keep the policy, simulate, and return the results of the first episodes, in order.

    `summary.json` has those that have ended. On an interrupt or an error every running episode
    ends after its RL step and completes its recording.

    Args:
        out: output folder; recordings go to `episodes/` in it.
        options: seed, driver, what is recorded; episode k draws from the seed sequence (seed, k).
        log: of the policy's training, which is recorded.
        viewer: address of a running viewer that is sent what is recorded, if any.
    """
    scenario, config, fmu = setup
    driver, seed = chosen_driver(options.driver, fmu, config), policy.config.seed
    summary = RunSummary(
        **run_facts(scenario, options.seed, fmu, driver),
        train_seed=[seed.entropy, *seed.spawn_key] if seed.spawn_key else seed.entropy,
        method=policy.config.method,
        parameters={name: row["value"] for name, row in config.table().items()},
        differing={name: leaf.table() for name, leaf in differing(config).items()},
    )
    facts = {k: v for k, v in structs.asdict(summary).items() if k not in _NO_FACTS}
    _refuse_other_results(out, summary, policy)
    policy.save(out / "policy.npz")
    level, sampled = options.record, sampled_of(scenario.robots, options.signals)
    if level != "none":
        warn_of_size(config, level, len(sampled))
        if log is not None:
            write_training(out / "training.rrd", policy, log, facts)

    def task(number: int) -> Task:
        starts, noise_seed = draw_episode(scenario, options.seed, number)

        def watch(step: Step, episode: RunningEpisode, wall_s: float) -> None:
            factor = episode.time_s / wall_s
            state = f"{episode.time_s:.0f} s, {factor:.1f} × real time {step.outcome}"
            total = episode.time_s if step.outcome else config.timing.episode_limit_s
            progress(f"episode {number}", episode.time_s, total, state)

        record = None
        if level != "none":
            of_episode = facts | {"episode": number, "starts": starts}
            record = Record(out / recording_of(number), of_episode, level, viewer)
        how = starts, noise_seed, record, watch, driver, sampled
        return Task(scenario, fmu, config, policy, *how)

    tasks = [task(number) for number in range(episodes)]
    with under_way(progress, "preparing the kernels"):
        compile_kernels(tasks[0], episodes, threads)
    ended: dict[int, EpisodeResult] = {}
    results: list[EpisodeResult] = []
    for number, result in simulate_tasks(tasks, threads):
        name = None if level == "none" else recording_of(number)
        ended[number] = structs.replace(result, recording=name)
        while len(results) in ended:
            results.append(ended[len(results)])
            write_json(out / "summary.json", structs.replace(summary, episodes=tuple(results)))
    return results


def recording_of(episode: int) -> str:
    """Return where the recording of an episode is in the output folder."""
    return f"episodes/ep_{episode:03d}.rrd"


def _refuse_other_results(out: Path, summary: RunSummary, policy: GreedyPolicy) -> None:
    """Refuse a folder with another run's results; those of this one are written again."""
    path = out / "summary.json"
    if not path.exists():
        return
    both = (read_json(path, _SUMMARY, RunSummary), summary)
    was, now = (msgspec.to_builtins(of.parameters | structs.asdict(of)) for of in both)
    same = {"parameters", "differing", "versions", "episodes"}
    other = [f"{k} = {v}" for k, v in was.items() if k not in same and v != now.get(k)]
    before = load_policy(out / "policy.npz")
    if (before.config, before.digest()) != (policy.config, policy.digest()):
        other.append("another policy")
    if other:
        raise ConfigError(f"{path} is of a run with {', '.join(other[:3])}; {_SUMMARY.fix}")

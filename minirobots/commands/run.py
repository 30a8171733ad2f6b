"""Train, co-simulate and record episodes."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from agent.training.settings import COMPUTED, Method
from cosim.base.command import workers
from cosim.base.errors import in_shell
from cosim.base.progress import Progress, under_way
from cosim.model.config import ConfigError
from cosim.recording.live import DEFAULT_VIEWER
from cosim.simulation.options import resolve
from minirobots.options import (
    Count,
    File,
    Jobs,
    NewFolder,
    NotNegative,
    ScenarioName,
    Seed,
    Simulating,
)

if TYPE_CHECKING:
    from agent.evaluation.series import RunFacts
    from agent.mdp.greedy import GreedyPolicy
    from agent.training.loop import TrainingLog
    from cosim.model.scenario import Scenario


class Run(NewFolder, Simulating):
    """Mini-robots learn to reach their targets, then drive there with motors, mass and friction.

    The agents are trained (or found in the cache if this configuration was trained before), and
    every episode of the co-simulation steps the motor FMUs and the rigid bodies with dt = 1e-5 s
    while the agents decide every 2 s. Results go to the output folder: summary.json, policy.npz,
    training.rrd and one recording per episode, to be opened in the Rerun viewer.

    fmpy loads the motor FMUs and steps them; python-control checks their speed
    loop (minirobots motor-loop); Gymnasium and PettingZoo environments (agent.envs) give other
    learners the same boards; Rerun keeps and shows every signal.
    """

    scenario: ScenarioName = "2"
    episodes: Count = 1
    """Episodes to co-simulate, each from start cells drawn with the seed."""
    method: Method | None = None
    """How agents learn: on the grid as in Section V (paper, the default for one robot or two on up
    to 1000 cells), or on moves observed in co-simulation (moves, the default with obstacles, for
    larger boards and for swarms). Or they are computed without learning: of one or two robots the
    joint paths that are optimal on the grid by length (shortest), of one or two the least time on
    observed moves (fastest; two with --through), of up to eight paths in space and time, which they
    plan while they drive (planned, the default for three to eight)."""
    train_episodes: Count | None = None
    """Episodes to train; by default 5 000 000 on the grid (Section V), and 1 500 000 on moves."""
    seed: Seed = 0
    train_seed: NotNegative | None = None
    """Seed of training: by default 0, so that every --seed uses the same policy, trained once."""
    again: Annotated[bool, tyro.conf.arg(aliases=["--retrain"])] = False
    """Train even if the cache has a policy of this configuration."""
    policy: File | None = None
    """Trained policy to use instead of training: a file (policy.npz)."""
    record: Literal["none", "summary", "default", "full"] = "default"
    """Amount to record: nothing (only summary.json and the policy are written); decisions and
    poses; every signal, motors at 1 kHz, under 20 MB per minute of two robots; or every signal at 1
    kHz with longer bursts at every tick."""
    signals: tuple[Count, ...] = ()
    """Robots with recorded signals, from 1; by default all of up to 64, else the first four. For
    the others only poses are recorded."""
    no_record: bool = False
    """Short for --record none."""
    live: bool = False
    """Send recorded data to a running Rerun viewer too, while the episodes run."""
    spawn: bool = False
    """Open a Rerun viewer on this machine and send it the recorded data."""
    viewer: Annotated[str, tyro.conf.arg(metavar="URL")] = DEFAULT_VIEWER
    """Address of the viewer for --live and --spawn."""
    jobs: Jobs = -1
    driver: Literal["fmpy", "compiled", "reference"] | None = None
    """Driver that steps the motor FMUs: fmpy calls doStep of fmpy's class once per control period
    of 1 ms; compiled calls their C functions at every tick (the same bits, an episode some 16 %
    faster); reference calls fmpy's class at every tick (the same bits, some 400 times slower).
    By default fmpy, and compiled with --reaction or a motor FMU without samples of its outputs."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.no_record:
            if self.record not in {"none", "default"}:
                raise ConfigError(
                    f"--no-record contradicts --record {self.record}; leave out one of them"
                )
            object.__setattr__(self, "record", "none")
        of_training = {
            "--method": self.method,
            "--train-episodes": self.train_episodes,
            "--train-seed": self.train_seed,
            "--again": self.again or None,
        }
        given = [name for name, value in of_training.items() if value is not None]
        if self.policy is not None and given:
            raise ConfigError(
                f"{' and '.join(given)}: nothing is trained with --policy, which names a trained "
                "policy; leave one of them out"
            )
        if self.viewer != DEFAULT_VIEWER and not (self.live or self.spawn):
            raise ConfigError("--viewer has no effect without --live or --spawn; add one of them")
        if self.record == "none" and self.signals:
            raise ConfigError("--signals has no effect where nothing is recorded; leave it out")
        if self.record == "none" and (self.live or self.spawn):
            raise ConfigError("--live and --spawn show what is recorded; choose another --record")

    def interrupted(self) -> str:
        """Return where the completed episodes are."""
        kept = (self.folder / "summary.json").exists()
        return f"what was simulated so far is in {self.folder}/" if kept else ""


def run(options: Run, progress: Progress) -> Iterator[Any]:
    """Train or load, co-simulate, record, and keep `summary.json` up to date.

    Print the outcome table, where the files are and how to open them.
    """
    from msgspec.structs import asdict
    from rich.console import Console
    from rich.table import Table

    from agent.evaluation.series import Series
    from agent.training.recording import write_training
    from cosim.coupling.rl_step import sampled_of
    from cosim.recording.live import find_viewer, spawn_viewer
    from cosim.recording.series import with_bursts
    from cosim.simulation.ahead import compiling_ahead
    from cosim.simulation.batch import chosen_driver
    from cosim.simulation.tasks import compile_kernels

    out = options.folder
    written = 0 if options.record == "none" else options.episodes
    if more := sorted((out / "episodes").glob("ep_*.rrd"))[written:]:
        raise ConfigError(
            f"{more[0]} is of a run of other episodes, and would stay next to the new summary; "
            "choose another --out, or remove it"
        )
    scenario, config, fmu = resolve(options.physics, options.scenario, progress)
    viewer = None
    if options.spawn:
        viewer = spawn_viewer(options.viewer)
    elif options.live:
        viewer = find_viewer(options.viewer)
    config = with_bursts(config, options.record)
    out.mkdir(parents=True, exist_ok=True)
    driver, threads = chosen_driver(options.driver, fmu, config), workers(options.jobs)
    with compiling_ahead(scenario.robots, driver, options.episodes, threads):
        policy, log = _policy(options, scenario, progress)
    facts = _facts(options, scenario, policy, fmu, driver)
    series = Series(
        scenario,
        fmu,
        config,
        policy,
        out,
        facts,
        viewer,
        options.record,
        progress,
        sampled_of(scenario.robots, options.signals),
    )
    series.refuse_other_results()
    policy.save(out / "policy.npz")
    if options.record != "none" and log is not None:
        write_training(out / "training.rrd", policy, log, asdict(facts))
    with under_way(progress, "preparing the kernels"):
        compile_kernels(series.task(0), options.episodes, threads)
    results = list(series.run(options.episodes, threads))
    yield {"episodes": results}
    table = Table("episode", "outcome", "path length", "rotation", "simulated", "× real time")
    table.add_column("recording", overflow="fold")
    for number, result in enumerate(results):
        table.add_row(
            str(number),
            result.outcome,
            f"{result.path_length_cm:.1f} cm",
            f"{result.rotation_deg:.0f}°",
            f"{result.sim_time_s:.0f} s",
            f"{result.realtime_factor:.1f}",
            result.recording or "none",
        )
    console = Console()
    console.print(table)
    console.print(f"results in {out}/: summary.json, policy.npz", soft_wrap=True)
    recordings = [out / r.recording for r in results if r.recording]
    if recordings:
        console.print(f"open with: {in_shell('rerun')} {recordings[0]}", soft_wrap=True)


def _policy(
    options: Run, scenario: "Scenario", progress: Progress
) -> "tuple[GreedyPolicy, TrainingLog | None]":
    from agent.method import best_method, method_policy
    from agent.policies import load_policy

    if options.policy is not None:
        return load_policy(options.policy, scenario), None
    method = options.method or best_method(scenario)
    if method in COMPUTED and (options.train_episodes or options.train_seed is not None):
        raise ConfigError(
            f"--train-episodes, --train-seed: method {method} is computed, not trained; leave them "
            "out, or choose a method that learns, such as moves"
        )
    policy, log, _ = method_policy(
        method,
        scenario,
        options.train_seed or 0,
        episodes=options.train_episodes,
        motor_fmu=options.physics.motor_fmu,
        motor_parameters=options.physics.motor_parameters,
        again=options.again,
        progress=progress,
    )
    return policy, log


def _facts(
    options: Run, scenario: "Scenario", policy: "GreedyPolicy", fmu: Path, driver: str
) -> "RunFacts":
    from agent.evaluation.series import RunFacts
    from agent.policies import method_name
    from cosim.base.provenance import versions
    from fmus.build import identity_of_fmu

    seed = policy.config.seed
    return RunFacts(
        scenario=scenario.name,
        title=scenario.title,
        seed=options.seed,
        train_seed=seed.entropy if not seed.spawn_key else [seed.entropy, *seed.spawn_key],
        driver=driver,
        motor_fmu=fmu.name,
        motor_fmu_digest=identity_of_fmu(fmu),
        method=method_name(policy),
        versions=versions(),
    )

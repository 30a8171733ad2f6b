"""`python -m cosim.run`: train, co-simulate, record. The composition root of the project."""

import json
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from agent.evaluation.batch import Batch
from agent.evaluation.rollout import EpisodeResult
from agent.methods import BEST, Method, method_of, method_policy
from agent.training import loop as training
from agent.training.policy import Policy
from agent.training.recording import write_training
from cosim.base.config import ConfigError, CoSimConfig
from cosim.base.errors import run_command
from cosim.base.params import SAFETY_MARGIN_HELP, SPEED_NOISE, STEERING, TABLE_I, TIMING
from cosim.base.provenance import versions
from cosim.base.scenario import Scenario, find_scenario
from cosim.base.storage import replacing
from cosim.navigation.calibration_cache import calibrated
from cosim.navigation.episode import CoSimulation
from cosim.recording.levels import DETAILS
from cosim.recording.live import DEFAULT_VIEWER, find_viewer, spawn_viewer
from fmus.build import cached_fmu

SUMMARY_SCHEMA_VERSION = 1


@dataclass(frozen=True)
class Run:
    """Mini-robots learn to reach their targets, then drive there with motors, mass and friction.

    The agents are trained on the grid (or found in the cache if this configuration was trained
    before), and every episode of the co-simulation steps the motor FMUs and the rigid bodies with
    dt = 1e-5 s while the agents decide every 2 s. Results go to the output folder: summary.json,
    policy.npz, training.rrd and one recording per episode, to be opened in the Rerun viewer.
    """

    scenario: str = "2"
    """Built-in scenario of Fig. 5 (1a, 1b, 2, 3, 4) or a scenario file (.toml)."""
    episodes: int = 1
    """Episodes to co-simulate, each from start cells drawn with the seed."""
    method: Method | None = None
    """How agents learn: on moves observed in co-simulation (moves, the default, the first time
    some 20 s more), on the grid as in Section V (paper), or on the grid with moves that go astray
    (slip)."""
    train_episodes: int | None = None
    """Episodes to train; by default 5 000 000 on the grid (Section V), 1 500 000 on moves."""
    seed: int = 0
    """Seed of start cells and speed noise."""
    train_seed: int | None = None
    """Seed of training: by default 0, so that every --seed meets the same policy, trained once."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Output folder; by default runs/<scenario>-<time>."""
    policy: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Trained policy to use (policy.npz) instead of training."""
    motor_fmu: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Motor FMU to use (FMI 3.0 Co-Simulation with the same interface) instead of the built-in."""
    retrain: bool = False
    """Train even if the cache has a policy of this configuration."""
    record: Literal["none", "summary", "default", "full"] = "default"
    """How much is recorded: nothing (only summary.json and the policy are written); decisions and
    poses; every signal, motors at 1 kHz, under 20 MB per minute of two robots; or every signal at
    1 kHz with longer bursts at every tick."""
    no_record: bool = False
    """Short for --record none."""
    live: bool = False
    """Send what is recorded to a running Rerun viewer as well, while the episodes run."""
    spawn: bool = False
    """Open a Rerun viewer on this machine and send it what is recorded."""
    viewer: Annotated[str, tyro.conf.arg(metavar="URL")] = DEFAULT_VIEWER
    """Address of the viewer for --live and --spawn."""
    jobs: int = 1
    """Episodes to co-simulate at the same time, in threads; the results do not depend on it."""
    driver: Literal["compiled", "reference", "adaptive"] = "compiled"
    """How the master reaches the FMUs: compiled code, fmpy's Python classes (some 100 times slower,
    the same bits), or fmpy with a communication step that adapts by rolling the FMUs back."""
    dt: Annotated[float, tyro.conf.arg(metavar="S")] = TIMING.dt_s
    """Integration step of the bodies in s."""
    communication_step: Annotated[float | None, tyro.conf.arg(metavar="S")] = None
    """Time between exchanges with the FMUs in s, a whole multiple of dt; by default dt."""
    order: Literal["gauss-seidel", "jacobi"] = "gauss-seidel"
    """Whether bodies see the motors' outputs of the end (interpolated) or of the start
    (extrapolated) of a communication step."""
    reaction: bool = False
    """Let the motors feel the acceleration of the body, which the paper neglects."""
    on_collision: Literal["end", "continue"] = "end"
    """What happens when two robots touch: the episode ends, or they push each other on. A robot
    that touches an obstacle always ends it: obstacles cannot be pushed against yet."""
    safety_margin: Annotated[float, tyro.conf.arg(metavar="M", help=SAFETY_MARGIN_HELP)] = 0.0
    mu: float = TABLE_I.mu
    """Coulomb friction coefficient of the feet (0.1 to 0.4 in the literature). Above some 0.2 the
    default --speed needs hopping and is refused."""
    noise: float = SPEED_NOISE.relative_amplitude
    """Half width of the uniform noise on measured motor speeds, relative to the drive speed."""
    speed: Annotated[float, tyro.conf.arg(metavar="MM_S")] = 1e3 * STEERING.drive_speed_m_s
    """Speed while driving, in mm/s; motor speeds follow from a calibration, which refuses a speed
    that needs hopping (above 4.4 with the default friction, 1.37 with a μ of 0.4)."""
    time_limit: Annotated[float, tyro.conf.arg(metavar="S")] = TIMING.episode_limit_s
    """Simulated time in s after which an episode ends as a time-out."""

    def __post_init__(self) -> None:
        for name in ("episodes", "train_episodes", "jobs"):
            if getattr(self, name) is not None and getattr(self, name) < 1:
                raise ConfigError(f"--{name.replace('_', '-')} must be at least 1")
        if min(self.seed, self.train_seed or 0) < 0:
            raise ConfigError("--seed and --train-seed must not be negative")
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
            "--retrain": self.retrain or None,
        }
        given = [name for name, value in of_training.items() if value is not None]
        if self.policy is not None and given:
            raise ConfigError(
                f"{' and '.join(given)}: nothing is trained with --policy, which names a trained "
                "policy; leave one of them out"
            )
        if self.record == "none" and (self.live or self.spawn):
            raise ConfigError("--live and --spawn show what is recorded; choose another --record")

    def config(self) -> CoSimConfig:
        """Parameters of the co-simulation.

        Raises:
            ConfigError: they do not fit together.
        """
        return CoSimConfig(
            robot=TABLE_I._replace(mu=self.mu),
            noise=SPEED_NOISE._replace(relative_amplitude=self.noise),
            timing=TIMING._replace(
                dt_s=self.dt,
                communication_step_s=self.communication_step or self.dt,
                episode_limit_s=self.time_limit,
                burst_s=0.0 if self.record == "none" else DETAILS[self.record].burst_s,
            ),
            steering=STEERING._replace(drive_speed_m_s=1e-3 * self.speed),
            order=self.order,
            reaction=self.reaction,
            on_collision=self.on_collision,
            safety_margin_m=self.safety_margin,
        )


def run(options: Run, console: Console) -> tuple[list[EpisodeResult], Path]:
    """Train or load, co-simulate, record, and write `summary.json`.

    Args:
        options: the command line.
        console: for progress; nothing is drawn if it is no terminal.

    Returns:
        The episodes' results and the output folder.

    Raises:
        UserError: see its message.
    """
    scenario = find_scenario(options.scenario)
    config = options.config().sized(scenario.robot_diameter_m)
    viewer = None
    if options.spawn:
        viewer = spawn_viewer(options.viewer)
    elif options.live:
        viewer = find_viewer(options.viewer)
    out = options.out or Path("runs") / f"{scenario.name}-{datetime.now():%Y%m%d-%H%M%S}"
    with console.status("preparing the motor FMU (some seconds the first time)"):
        fmu = options.motor_fmu or cached_fmu()
    config = calibrated(config, fmu, console)
    with console.status("preparing the kernels (some seconds the first time)"):
        system = CoSimulation(scenario, fmu, config, options.driver)
        out.mkdir(parents=True, exist_ok=True)
        system.compile()
    policy, log = _policy(options, scenario, console)
    facts = _facts(options, scenario, policy, fmu)
    policy.save(out / "policy.npz")
    if options.record != "none" and log is not None:
        write_training(out / "training.rrd", policy, log, facts)

    batch = Batch(scenario, fmu, config, options.driver, options.seed, policy, out, facts, viewer)
    results: list[EpisodeResult] = []
    try:
        for result in batch.run(range(options.episodes), options.jobs, options.record, console):
            results.append(result)
            _write_summary(out / "summary.json", config, facts, results)
    except KeyboardInterrupt:
        console.print(f"what was simulated so far is in {out}/", soft_wrap=True)
        raise
    return results, out


def _policy(
    options: Run, scenario: Scenario, console: Console
) -> tuple[Policy, training.TrainingLog | None]:
    if options.policy is not None:
        return Policy.load(options.policy, scenario), None
    columns = ("[progress.description]{task.description}", "{task.fields[state]}")
    with Progress(
        TextColumn(columns[0]),
        BarColumn(),
        TextColumn(columns[1]),
        TimeRemainingColumn(),
        console=console,
        disable=not console.is_terminal,
    ) as bar:
        moves = bar.add_task("observing moves", total=None, state="", visible=False)
        task = bar.add_task("training", total=None, state="")

        def observing(done: int, total: int) -> None:
            bar.update(moves, completed=min(done, total), total=total, visible=True)

        def show(progress: training.TrainingProgress) -> None:
            state = f"success {progress.success:.1%}  ε {progress.epsilon:.3f}"
            bar.update(task, completed=progress.episode, total=progress.episodes, state=state)

        policy, log, path = method_policy(
            options.method or BEST,
            scenario,
            options.train_seed or 0,
            episodes=options.train_episodes,
            motor_fmu=options.motor_fmu,
            retrain=options.retrain,
            observing=observing,
            progress=show,
        )
        bar.update(task, total=1, completed=1, state=f"policy in {path}")
    return policy, log


def _facts(options: Run, scenario: Scenario, policy: Policy, fmu: Path) -> dict[str, Any]:
    """What identifies a run, for summaries and recordings; the same for equal runs.

    A training seed that was spawned from an experiment's is a list, the experiment's seed first.
    """
    seed = policy.config.seed
    return {
        "scenario": scenario.name,
        "title": scenario.title,
        "seed": options.seed,
        "train_seed": seed.entropy if not seed.spawn_key else [seed.entropy, *seed.spawn_key],
        "driver": options.driver,
        "motor_fmu": fmu.name,
        "method": method_of(policy.config) or "other",
        "versions": versions(),
    }


def _write_summary(
    path: Path,
    config: CoSimConfig,
    facts: dict[str, Any],
    results: list[EpisodeResult],
) -> None:
    summary = {
        "schema_version": SUMMARY_SCHEMA_VERSION,
        **facts,
        "parameters": {name: row["value"] for name, row in config.table().items()},
        "episodes": [vars(result) for result in results],
    }
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")


def _show(results: list[EpisodeResult], out: Path) -> None:
    """Print the outcome table, where the files are and how to open them."""
    table = Table("episode", "outcome", "path length", "simulated", "× real time")
    table.add_column("recording", overflow="fold")
    for number, result in enumerate(results):
        table.add_row(
            str(number),
            result.outcome,
            f"{result.path_length_cm:.1f} cm",
            f"{result.sim_time_s:.0f} s",
            f"{result.realtime_factor:.1f}",
            result.recording or "none",
        )
    console = Console()
    console.print(table)
    console.print(f"results in {out}/: summary.json, policy.npz", soft_wrap=True)
    recordings = [out / r.recording for r in results if r.recording]
    if recordings:
        console.print(f"open with: uv run rerun {recordings[0]}", soft_wrap=True)


def main() -> None:
    """Command line; see `Run`."""
    options = tyro.cli(Run, prog="python -m cosim.run", config=(tyro.conf.FlagCreatePairsOff,))
    results, out = run(options, Console(stderr=True))
    _show(results, out)


if __name__ == "__main__":
    run_command(main)

"""Commands that simulate episodes: a run of them, and one that was recorded, again."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from cosim.base import command as opt
from cosim.base.arguments import ConfigError
from cosim.base.errors import in_shell
from cosim.base.progress import Progress
from cosim.base.table import show_texts
from cosim.model.config import GIVEN
from cosim.model.params import STEERING
from cosim.model.scenario_file import find_scenario
from cosim.recording.live import DEFAULT_VIEWER, find_viewer, spawn_viewer
from cosim.simulation.options import (
    EpisodeOptions,
    Setup,
    SimulationOptions,
    declared,
    differing,
    resolve,
)
from minirobots.runner import Command, Output

if TYPE_CHECKING:
    from agent.mdp.greedy import GreedyPolicy
    from agent.training.loop import TrainingLog
    from agent.training.methods import Method
    from cosim.model.config import CoSimConfig
    from cosim.model.scenario import Scenario

CALIBRATED = "calibrated"  # source of what follows from the other parameters
_LISTED = 6  # differences on the console
_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class OfPolicy(Command):
    """Base of commands that take a trained policy: as their first word, or as --policy."""

    first: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY.npz")] = None
    """Trained policy, the same as --policy."""
    policy: opt.OptionalFile = None
    """Trained policy to use instead of one that is made, or found in the cache."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.first and self.policy not in (None, self.first):
            raise ConfigError(f"--policy {self.policy} and {self.first}: name one policy")
        object.__setattr__(self, "policy", self.first or self.policy)


@dataclass(frozen=True, kw_only=True)
class Run(OfPolicy):
    """Mini-robots learn to reach their targets, then drive there with motors, mass and friction.

    The agents are trained (or found in the cache if this configuration was trained before), and
    every episode of the co-simulation steps the motor FMUs and the rigid bodies with dt = 1e-5 s
    while the agents decide every 2 s. Results go to the output folder: summary.json, policy.npz,
    training.rrd and one recording per episode, to be opened in the Rerun viewer.

    fmpy loads the motor FMUs and steps them; python-control checks their speed loop (minirobots
    motor-loop); Gymnasium and PettingZoo environments (agent.envs) give other learners the same
    boards; Rerun keeps and shows every signal.
    """

    kept = "results so far are in {out}/"

    scenario: opt.ScenarioName = "2"
    out: opt.NewFolder = None
    episodes: opt.Count = 1
    """Episodes to co-simulate, each from start cells drawn with the seed."""
    method: opt.MethodName | None = None
    """How agents learn: on the grid as in Section V (paper, the default for one robot or two on up
    to 1000 cells), or on moves observed in co-simulation (moves, the default with obstacles, for
    larger boards and for swarms). Or they are computed without learning: of one or two robots the
    joint paths that are optimal on the grid by length (shortest), of one or two the least time on
    observed moves (fastest; two with --through), of up to eight paths in space and time, which they
    plan while they drive (planned, the default for three to eight)."""
    train_episodes: opt.Count | None = None
    """Episodes to train; by default 5 000 000 on the grid (Section V), and 1 500 000 on moves."""
    train_seed: opt.NotNegative | None = None
    """Seed of training: by default 0, so that every --seed uses the same policy, trained once."""
    again: Annotated[bool, tyro.conf.arg(aliases=["--retrain"])] = False
    """Train even if the cache has a policy of this configuration."""
    no_record: bool = False
    """Short for --record none."""
    show_config: bool = False
    """Print every parameter of the episodes with its unit and source, a line each, and end. Nothing
    is simulated: those of the steering that a calibration finds have their defaults."""
    live: bool = False
    """Send recorded data to a running Rerun viewer too, while the episodes run."""
    spawn: bool = False
    """Open a Rerun viewer on this machine and send it the recorded data."""
    viewer: Annotated[str, tyro.conf.arg(metavar="URL")] = DEFAULT_VIEWER
    """Address of the viewer for --live and --spawn."""
    jobs: opt.Jobs = -1
    physics: Annotated[EpisodeOptions, tyro.conf.OmitArgPrefixes] = field(
        default_factory=EpisodeOptions
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        record = self.physics.record
        if self.no_record and record not in {"none", "default"}:
            raise ConfigError(f"--no-record contradicts --record {record}; leave out one of them")
        if self.no_record:
            object.__setattr__(self, "physics", replace(self.physics, record="none"))
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
        recorded = self.physics.record != "none"
        if not recorded and self.physics.signals:
            raise ConfigError("--signals has no effect where nothing is recorded; leave it out")
        if not recorded and (self.live or self.spawn):
            raise ConfigError("--live and --spawn show what is recorded; choose another --record")

    def subject(self) -> str:
        return find_scenario(self.scenario).name

    def run(self, progress: Progress) -> Output:
        from agent.evaluation.run import run_episodes
        from agent.training.loop import learnt
        from cosim.recording.series import with_bursts
        from cosim.simulation.ahead import compiling_ahead
        from cosim.simulation.batch import chosen_driver

        out, threads, record = self.out, opt.workers(self.jobs), self.physics.record
        assert out is not None
        written = 0 if record == "none" else self.episodes
        if more := sorted((out / "episodes").glob("ep_*.rrd"))[written:]:
            raise ConfigError(
                f"{more[0]} is of a run of other episodes, and would stay next to the new summary; "
                "choose another --out, or remove it"
            )
        if self.show_config:
            config = declared(self.physics, self.scenario, progress)
            leaves = with_bursts(config, record).leaves().values()
            return Output({leaf.path: leaf.table() for leaf in leaves}, *map(str, leaves))
        if self.policy is None:  # refused before anything is measured
            board, _ = self.physics.board(self.scenario, self.physics.world)
            self._method(board).check(board)
        scenario, config, fmu = resolve(self.physics, self.scenario, progress)
        if slow := slowed(config):  # before episodes that take long
            _LOGGER.warning(slow)
        viewer = None
        if self.spawn:
            viewer = spawn_viewer(self.viewer)
        elif self.live:
            viewer = find_viewer(self.viewer)
        setup = Setup(scenario, with_bursts(config, record), fmu)
        driver = chosen_driver(self.physics.driver, fmu, setup.config)
        with compiling_ahead(scenario.robots, driver, self.episodes, threads):
            policy, log = self._policy(scenario, progress)
        policy.warn_of_machine(config)
        achieved = None if log is None else learnt(policy.config, log)
        if achieved is not None and not achieved.suffices:  # before episodes that take long
            _LOGGER.warning("training: %s", achieved)
        how = {"log": log, "viewer": viewer, "progress": progress}
        work = {"episodes": self.episodes, "threads": threads}
        results = run_episodes(setup, policy, out, self.physics, **work, **how)
        names = "episode", "outcome", "path length", "rotation", "simulated", "× real time"
        rows = [
            (
                str(number),
                result.outcome,
                f"{result.path_length_cm:.1f} cm",
                f"{result.rotation_deg:.0f}°",
                f"{result.sim_time_s:.0f} s",
                f"{result.realtime_factor:.1f}",
                result.recording or "none",
            )
            for number, result in enumerate(results)
        ]
        first = [out / result.recording for result in results[:1] if result.recording]
        learnt_on_grid = log is not None and getattr(policy.config, "method", "") == "paper"
        return Output(
            {"episodes": results, "training": achieved},
            partial(show_texts, (*names, "recording"), rows),
            *([] if achieved is None else [f"training: {achieved}"]),
            *_differences(config),
            f"results in {out}/: summary.json, policy.npz",
            *(f"open with: {in_shell('rerun')} {path}" for path in first),
            *(["a faster policy: --method fastest --through (docs/methods.md)"] * learnt_on_grid),
        )

    def _method(self, board: "Scenario") -> "Method":
        from agent.training.methods import best_method, find_method

        method = find_method(self.method or best_method(board))
        if method.compute and (self.train_episodes or self.train_seed is not None):
            raise ConfigError(
                f"--train-episodes, --train-seed: method {method.name} is computed, not trained; "
                "leave them out, or choose a method that learns, such as moves"
            )
        return method

    def _policy(
        self, scenario: "Scenario", progress: Progress
    ) -> "tuple[GreedyPolicy, TrainingLog | None]":
        from agent.training.methods import method_config
        from agent.training.policy import load_policy
        from agent.training.store import find_or_make

        if self.policy is not None:
            return load_policy(self.policy, scenario), None
        how = {"options": self.physics, "episodes": self.train_episodes, "progress": progress}
        config = method_config(self._method(scenario), scenario, self.train_seed or 0, **how)
        return find_or_make(config, again=self.again, progress=progress)[:2]


def slowed(config: "CoSimConfig") -> str:
    """Return why robots drive more slowly than by default; nothing if they do not, or are told."""
    speed_m_s = config.steering.drive_speed_m_s
    source = config.leaves()["drive_speed_m_s"].quantity.source
    if speed_m_s >= STEERING.drive_speed_m_s or source == GIVEN:
        return ""
    return (
        f"robots drive {1e3 * speed_m_s:.1f} mm/s, not {1e3 * STEERING.drive_speed_m_s:.1f}: "
        f"{source.removeprefix('computed: ')} (mu = {config.robot.mu:g}); episodes end after "
        f"{config.timing.episode_limit_s:g} s at the latest"
    )


def _differences(config: "CoSimConfig") -> Iterator[str]:
    """Yield what was given in place of the defaults, a line each."""
    own = [leaf for leaf in differing(config).values() if leaf.quantity.source != CALIBRATED]
    if own:
        yield "not the default (summary.json has all):"
    for leaf in own[:_LISTED]:
        short = f"{leaf.value:.4g}" if isinstance(leaf.value, float) else leaf.value
        yield f"  {leaf._replace(value=short)}"


@dataclass(frozen=True, kw_only=True)
class Web(OfPolicy):
    """Write one HTML file in which the robots of a policy drive in any browser, without network.

    It computes the co-simulation, by the same code compiled to WebAssembly, for any seed: an
    episode has the bits of `minirobots run`. The file opens from disk, also on a phone.
    """

    scenario: opt.ScenarioName = "4"
    method: opt.MethodName | None = None
    """Method that makes the policy, as in `minirobots run`, by default that of the scenario."""
    out: opt.File = Path("page.html")
    """Page to write (.html)."""
    worlds: tuple[str, ...] = ()
    """More worlds to choose from in the page: rough, or world files (.toml) with the obstacles of
    the scenario. Set points are calibrated for each."""
    seed: opt.Seed = 0
    physics: Annotated[SimulationOptions, tyro.conf.OmitArgPrefixes] = field(
        default_factory=SimulationOptions
    )

    def run(self, progress: Progress) -> Output:
        from agent.web.page import write_page

        made = {"policy": self.policy, "method": self.method, "worlds": self.worlds}
        how = {"seed": self.seed, "progress": progress}
        size = write_page(self.out, self.scenario, self.physics, **made, **how)
        text = f"page in {self.out} ({size / 1e6:.2f} MB); open it in a browser"
        return Output({"page": str(self.out), "bytes": size}, text)


@dataclass(frozen=True, kw_only=True)
class Replay(Command):
    """Run a recorded episode again and compare every signal, bit for bit.

    Scenario, parameters, start cells and seeds are those of the recording; the policy is that of
    the run. Exits with status 1 if anything differs. A recording that a killed run left is compared
    as far as it goes.
    """

    recording: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RECORDING.rrd")]
    """Recording of an episode."""
    policy: opt.OptionalFile = None
    """Policy of the run; by default policy.npz in the folder above that of the recording."""
    motor_fmu: opt.MotorFmuFile = None

    def run(self, progress: Progress) -> Output:
        from analysis.compare import differing, replay

        found = replay(self.recording, self.policy, self.motor_fmu, progress)
        count, differences = found["signals"], found["differences"]
        ended = "" if found["complete"] else " as far as the recording goes, which is not complete"
        return Output(
            found,
            *(
                f"{name} was {was} when it was recorded, and is {now or 'missing'} now"
                for name, (was, now) in found["versions"].items()
            ),
            *(differing(each["signal"], each["time_s"]) for each in differences),
            f"{count - len(differences)} of {count} signals ({found['values']} values) are equal "
            f"in every bit{ended}",
            failed=bool(differences),
        )

"""Commands that make policies, and say what they achieve."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Self

import tyro

from agent.experiments.variants import ExperimentOptions
from agent.mdp.config import ProcessConfig
from agent.moves.worlds import RANGES, WorldRange, checked_ranges
from agent.study.options import Sampling
from agent.training.settings import LearningConfig, read_settings
from cosim.base import command as opt
from cosim.base.arguments import ConfigError, require_one_of, validate_argument
from cosim.base.errors import UserError, in_shell
from cosim.base.jobs import PROCESSES, THREADS, Where
from cosim.base.progress import Progress
from cosim.base.storage import require_suffix
from cosim.base.table import show_texts
from cosim.model.preset import PAPER
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.simulation.options import DecisionOptions, Physics, SimulationOptions
from minirobots.runner import RESUMES, Command, Output

AsOptions = Annotated[SimulationOptions, tyro.conf.OmitArgPrefixes]


@dataclass(frozen=True, kw_only=True)
class Methods(Command):
    """Print the methods that make policies: how, for how many robots, and when to use them.

    They are the values of --method of `minirobots run`. docs/methods.md compares what they achieve.
    """

    def run(self, progress: Progress) -> Output:
        from agent.training.methods import METHODS

        rows = [{"method": name, **method.facts} for name, method in METHODS.items()]
        cells = [tuple(row.values()) for row in rows]
        return Output({"methods": rows}, lambda: show_texts(tuple(rows[0]), cells))


@dataclass(frozen=True, kw_only=True)
class Train(Command):
    """Train agents on the grid, or on moves: independent runs, each with a seed of its own.

    Every run gets a folder with its policy, its learning curves and a recording for the Rerun
    viewer; runs are evaluated from every start. The same command with --out continues after an
    interrupt, and the results are bit-identical to those of a command that was not interrupted.
    """

    kept = RESUMES

    scenario: opt.ScenarioName = "4"
    method: opt.MethodName | None = None
    """How agents learn: a method that learns, or one of yours (CONTRIBUTING.md); by default as in
    Section V (paper), or moves if there is a file of them. Runs of yours are not continued, as its
    code may have changed."""
    out: opt.NewFolder = None
    runs: opt.Count = 1
    """Independent runs (the paper: 20)."""
    seed: opt.Seed = 0
    config: opt.OptionalFile = None
    """Settings file with tables [process] and [learning] in place of those of the method; options
    given here override it."""
    moves: opt.OptionalFile = None
    """Moves observed by `minirobots moves`: train on them instead of the grid."""
    preset: opt.PresetName = PAPER
    world: opt.OptionalFile = None
    """World (.toml) whose obstacles the agents learn; by default that of the scenario file."""
    motor_fmu: opt.MotorFmuFile = None
    motor_parameters: opt.MotorParameters = ()
    where: Where = PROCESSES
    process: ProcessConfig = field(default_factory=ProcessConfig)
    learning: LearningConfig = field(default_factory=LearningConfig)

    @classmethod
    def defaults(cls, arguments: list[str]) -> Self | None:
        words = [word for argument in arguments for word in argument.split("=", 1)]
        given = dict(itertools.pairwise(words))
        if config := given.get("--config"):
            process, learning = read_settings(Path(config))
            return cls(config=Path(config), process=process, learning=learning)
        if method := given.get("--method") or ("moves" if "--moves" in given else None):
            from agent.training.methods import find_method

            scenario = find_scenario(given.get("--scenario", cls.scenario))
            process, learning = find_method(method).settings(scenario)
            return cls(process=process, learning=learning)
        return None

    def interrupted(self) -> str:
        own = self.method and ":" in self.method
        return f"results so far are in {self.out}/" if own else super().interrupted()

    def subject(self) -> str:
        return f"train-{find_scenario(self.scenario).name}"

    def run(self, progress: Progress) -> Output:
        from agent.experiments.run import train_and_evaluate
        from agent.moves.model import ObservedMoves
        from agent.training.methods import find_method, method_config
        from agent.training.runs import RunsConfig

        assert self.out is not None
        moves = self.moves and ObservedMoves.load(self.moves)
        method = find_method(self.method or ("moves" if moves else "paper"))
        if method.compute is not None:
            raise ConfigError(
                f"--method {method.name}: it is computed, not trained; name a method that learns"
            )
        if moves and not method.moves:
            raise ConfigError(
                f"--moves {self.moves}: no effect on method {method.name}, which does not learn on "
                "moves; leave it out, or choose --method moves"
            )
        motors = {"motor_fmu": self.motor_fmu, "motor_parameters": self.motor_parameters}
        config = method_config(
            method,
            self.scenario,
            options=Physics(preset=self.preset, **motors),
            world=self.world,
            process=self.process,
            learning=self.learning,
            moves=moves,
            alone=True,
            progress=progress,
        )
        settings = config.scenario, config.process, config.learning
        runs = RunsConfig(*settings, self.seed, self.runs, config.moves, config.method)
        summary = train_and_evaluate(runs, self.out, where=self.where, progress=progress)
        more = ", and training.rrd of all runs" if self.runs > 1 else ""
        files = f"summary.json, run_*/policy.npz, training.npz, training.rrd{more}"
        return Output(summary, summary.show, f"results in {self.out}/: {files}")


@dataclass(frozen=True, kw_only=True)
class Evaluate(Sampling, Command):
    """Evaluate policies in the full co-simulation: motors, friction, noise, decisions every 2 s.

    Every start, or a sample drawn with the seed, gives one episode; rates have 95 % Wilson
    intervals, paths are compared with the policy's own on the grid. Every result is kept when the
    episode ends: the same command, or one that asks for more starts, resumes. Failures and a few
    successes are recorded for the Rerun viewer. With --claim the exit status is 1 unless every
    policy is certified.

    With --grid every policy is evaluated on the grid instead, by the greedy episode from every
    combination of start cells. Up to 10 000 combinations nothing is sampled: scenarios 1a, 1b and 2
    to 4 have 30, 116 and 900. Where there are more, 10 000 are drawn, and success has a 95 %
    interval. Path length and moves are means over robots and successful starts; their ratio to the
    exact optimum (minirobots bound) shows how far a policy is from the best possible one.
    """

    policies: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    """Policies (policy.npz), folders of runs made by `minirobots train`, names of methods, or
    MODULE:NAME of an object with act(observation) or of its class; methods and objects need a
    --scenario."""
    policy: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """A policy as above; repeat it for several."""
    grid: bool = False
    """Evaluate on the grid, exactly; takes files and folders of runs, and no option but --json."""
    starts: str | None = None
    """Number of starts to sample without replacement, or 'all' (1a 30, 1b 116, pairs 900, those
    that start on one side 600); by default 50, or all where there are fewer. With --claim the
    maximum number of episodes, by default all starts; more than that begin again with the first
    start, each time with other noise."""
    scenario: str | None = None
    """Scenario (a name, or a file) of methods and objects; files of any other one are refused."""
    out: opt.Folder = Path("runs/evaluate")
    """Folder of results and recordings; results of other configurations are kept apart in it."""
    recordings: opt.NotNegative = 3
    """Episodes of each policy to record: at most this number of failures and of successes."""
    physics: AsOptions = field(default_factory=SimulationOptions)

    def __post_init__(self) -> None:
        super().__post_init__()
        number = self.starts is None or (self.starts.isdecimal() and int(self.starts) > 0)
        if not number and self.starts != "all":
            raise ConfigError(f"--starts {self.starts} is neither 'all' nor a positive number")
        if self.grid:
            of_grid = {"policies", "policy", "grid", "json"}
            if without := [name for name in _changed(self, Evaluate()) if name not in of_grid]:
                named = ", ".join(f"--{name.replace('_', '-')}" for name in without)
                raise ConfigError(f"{named}: no effect with --grid; leave one of them out")

    def interrupted(self) -> str:
        return "" if self.grid else RESUMES.format(out=self.out)

    def run(self, progress: Progress) -> Output:
        policies = (*self.policies, *self.policy)
        if self.grid:
            from agent.study import grid
            from agent.training.policy import load_policy

            paths = grid.policy_files(tuple(map(Path, policies)))
            exact = grid.report_of((str(path), load_policy(path)) for path in paths)
            return Output(exact, exact.show)
        from agent.study.grid import EvaluationReport, policy_files
        from agent.study.policies import name_of
        from agent.study.store import EpisodeStore
        from agent.study.user import STARTS, measured

        count = int(self.starts) if self.starts and self.starts.isdecimal() else None
        report = measured(
            {name_of(policy): policy for policy in policy_files(policies)},
            [self.scenario],
            self,
            vars(self.physics),
            count if self.starts or self.claim else STARTS,
            EpisodeStore(self.out),
            progress,
            exactly=count is not None,
            recordings=self.recordings,
            episodes=False,
            kind=EvaluationReport,
        )
        recordings = [path for row in report.rows for path in row.recordings]
        return Output(
            report,
            report.show,
            f"results in {self.out}/",
            *(f"open with: {in_shell('rerun')} {path}" for path in recordings[:1]),
            failed=any(row.claim and row.claim.verdict != "certified" for row in report.rows),
        )


def _changed(given: Any, default: Any) -> Iterator[str]:
    """Names of options that are not the default, those of nested records too."""
    for option in fields(given):
        value, usual = getattr(given, option.name), getattr(default, option.name)
        if is_dataclass(value):
            yield from _changed(value, usual)
        elif value != usual:
            yield option.name


@dataclass(frozen=True, kw_only=True)
class Study(Command):
    """Measure policies in every combination of scenarios, worlds and options of a TOML file.

    docs/studies.md describes the file. Every episode is kept when it ends: the same command
    resumes, and with --budget-minutes 0 it starts no episode and writes the tables of existing
    results. Policies and calibrations that are missing are made first.
    """

    kept = "episodes so far are kept; the same command continues"

    file: Annotated[Path, tyro.conf.Positional]
    """Study (.toml)."""
    out: opt.Folder | None = None
    """Folder of the tables (study.json, .md, .parquet, .png, episodes.parquet) and results; by
    default that of the file, or runs/ and its name."""
    trainings: opt.Count | None = None
    """Trainings of each method that learns; by default the number in the file, or 1."""
    quantity: str = "success"
    """Quantity of the plot: success, collision, out_of_board, timeout, path_length_cm,
    rotation_deg, path_ratio_to_grid, min_distance_cm, sim_time_s or energy_j."""
    budget_minutes: opt.BudgetMinutes = None
    where: Where = THREADS

    def run(self, progress: Progress) -> Output:
        from agent.study.plot import QUANTITIES
        from agent.study.user import read_study, study

        require_one_of("quantity", self.quantity, QUANTITIES)
        arguments = read_study(self.file)
        out = self.out or validate_argument(
            "out", arguments.get("out", Path("runs") / self.file.stem), Path
        )
        work = {"out": out, "budget_minutes": self.budget_minutes, "progress": progress}
        if self.trainings is not None:
            work["trainings"] = self.trainings
        table = study(**{**arguments, **vars(self.where), **work})
        if self.quantity != "success":
            table.write(out / "study.png", self.quantity)
        return Output(
            {"out": str(out), "rows": [row.record() for row in table.rows]},
            table.show,
            f"tables in {out}/: study.json, .md, .parquet, .png and episodes.parquet",
        )


@dataclass(frozen=True, kw_only=True)
class Bound(Command):
    """Exact optimum of a scenario: the least mean path length and number of moves of any policy.

    Path length and moves are bounded separately, each by Dijkstra's algorithm over the joint
    process; a policy need not be able to reach both at once. Results are cached.
    """

    scenario: opt.ScenarioName = "4"
    process: ProcessConfig = field(default_factory=ProcessConfig)
    """Interpretations of the paper; only target_obstacle and collision limit the paths."""

    def __post_init__(self) -> None:
        for name in _changed(self.process, ProcessConfig()):
            if name not in {"target_obstacle", "collision"}:
                option = name.replace("_", "-")
                raise UserError(f"--process.{option} has no effect on the optimum; leave it out")

    def run(self, progress: Progress) -> Output:
        from agent.mdp.exact import enumerable, joint_starts
        from agent.mdp.interpretations import build_process
        from agent.mdp.optimum import optimum, require_paths

        scenario = find_scenario(self.scenario)
        process = build_process(scenario, self.process)
        bound = optimum(process)
        require_paths(process, bound.path_cells, alone=bound.relaxed)
        starts = joint_starts(process)
        path_cells, steps = (float(mean.mean()) for mean in bound.of_starts(starts, scenario.rows))
        length_cm, drawn = 100.0 * scenario.cell_m * path_cells, not enumerable(process)
        over = f"{len(starts)} starts" + (", drawn" if drawn else "")
        alone = "; each robot on its own, as if no other were there" if bound.relaxed else ""
        return Output(
            {
                "scenario": scenario.name,
                "starts": len(starts),
                "drawn": drawn,
                "relaxed": bound.relaxed,
                "path_length_cm": length_cm,
                "steps": steps,
            },
            f"scenario {scenario.name}: no policy has a mean path below {length_cm:.3f} cm, or "
            f"fewer than {steps:.3f} moves on average ({over}{alone})",
        )


@dataclass(frozen=True, kw_only=True)
class ObserveMoves(Command):
    """Observe moves of one robot in the co-simulation and keep what they did.

    The file lists every move (direction, heading, previous direction; Δcell, duration, where it
    stopped); `minirobots train --moves FILE` trains with them. With --worlds the policy learns for
    worlds that are not ideal.
    """

    out: opt.File = Path("runs/moves.json")
    """File to write (.json)."""
    moves: opt.Count = 24
    """Moves of each of the 8 kinds (straight or diagonal, after a turn of 0, 45, 90 or -45 deg)."""
    worlds: bool = False
    """Let every walk drive in a world of its own, drawn from the ranges below."""
    ranges: Annotated[WorldRange, tyro.conf.arg(name="worlds")] = RANGES
    """Ranges that worlds are drawn from uniformly, see docs/scenarios.md."""
    cell: Annotated[opt.Positive, tyro.conf.arg(metavar="M")] = Scenario.cell_m
    """Edge of a cell in m, that of the scenario to train in."""
    seed: opt.Seed = 0
    jobs: opt.Jobs = -1
    physics: Annotated[Physics, tyro.conf.OmitArgPrefixes] = field(default_factory=Physics)
    deciding: Annotated[DecisionOptions, tyro.conf.OmitArgPrefixes] = field(
        default_factory=DecisionOptions
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.worlds and self.physics.mu is not None:
            raise ConfigError("--mu has no effect with --worlds, which draws it; leave one out")
        if not self.worlds and self.ranges != RANGES:
            raise ConfigError("ranges have no effect without --worlds; add it")

    def run(self, progress: Progress) -> Output:
        from agent.moves.model import require_rl_step
        from agent.moves.observe import facts_of, move_rows, observe_moves

        out, jobs = require_suffix(self.out, ".json"), opt.workers(self.jobs)
        config, fmu = self.physics.prepare(progress=progress)
        config = config.merged(self.deciding.tree())
        require_rl_step(config.timing.rl_step_s)
        moves = observe_moves(
            config,
            fmu,
            moves_per_kind=self.moves,
            seed=self.seed,
            worlds=checked_ranges(self.ranges, config) if self.worlds else None,
            cell_m=self.cell,
            jobs=jobs,
            progress=progress,
        )
        moves.save(out)
        result = facts_of(moves) | {"out": str(out)}
        return Output(result, lambda: show_texts(*move_rows(moves)), f"moves in {out}")


@dataclass(frozen=True, kw_only=True)
class Experiments(ExperimentOptions, Command):
    """Run a learning experiment of the paper over many seeds and evaluate every run.

    fig08: one robot, scenarios 1a and 1b. fig10: the coefficient c. fig11: pairs, scenarios 2, 3
    and 4. features: which of x, y, d, g (and the bearing b) a robot needs. readings: the effect of
    each assumed interpretation of the paper. zone: scenarios 1a to 4 with the central zone open and
    forbidden. factorial: c under every combination of zone, target obstacle, η and ε in scenarios 2
    to 4, 192 variants; choose fewer --episodes. sequel: groups of four and six robots, by
    Q-learning and double Q-learning. The same command with --out continues after an interrupt. Draw
    the figures with `minirobots figures`.
    """

    kept = RESUMES

    def subject(self) -> str:
        return self.experiment

    def run(self, progress: Progress) -> Output:
        from agent.experiments.results import show
        from agent.experiments.run import run_experiment

        result = run_experiment(self, progress)
        return Output(result, partial(show, result))

"""Trains the learners of the table seed by seed, and lets their policies drive in the dynamics.

Every training and every episode is kept as it ends. The learners are `agent.baselines.learners`,
the table `agent.baselines.table`.
"""

import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import product
from pathlib import Path

import msgspec
import numpy as np

from agent.baselines import LEARNERS, Learner
from agent.baselines.learners import Config, config_of, digest, train
from agent.baselines.table import COLUMNS, BaselinesReport, Drive, LearnerRun, report_of
from agent.evaluation.grid import PolicyMeasures, measure
from agent.mdp.config import ProcessConfig
from agent.mdp.exact import Milestone, joint_starts
from agent.mdp.optimum import optimum
from agent.mdp.readings import build_process
from agent.method import method_config, moves_of
from agent.moves.bound import least_times_of_starts
from agent.policies import load_policy
from agent.study.episodes import StudyLine, case_of, simulate
from agent.study.store import EpisodeStore
from agent.training.settings import COMPUTED
from cosim.base.errors import UserError
from cosim.base.jobs import Workers, until
from cosim.base.progress import Progress, silent
from cosim.base.reading import Kind, read_json
from cosim.base.storage import write_json
from cosim.base.table import markdown, write_report
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.simulation.options import SimulationOptions
from cosim.simulation.result import EpisodeResult

_FILE = Kind("file of a training", "remove it", UserError)


@dataclass
class _Training:
    """A learner in a scenario with a seed, and where its training is kept.

    Attributes:
        out: folder of trainings and policies.
        scenario, learner, seed, quick: what is trained, see `config_of`.
        progress: receives what is observed and trained.
        drives: its episodes in the dynamics, as far as they are known.
    """

    out: Path
    scenario: Scenario
    learner: Learner
    seed: int
    quick: bool
    progress: Progress
    drives: tuple[Drive, ...] = ()

    @cached_property
    def _config(self) -> Config:
        return config_of(self.learner, self.scenario, self.seed, self.quick, self.progress)

    @cached_property
    def path(self) -> Path:
        """File of the training, written when it has ended."""
        name = f"{self.scenario.name}-{self.learner}-{self.seed}-{digest(self._config)}.json"
        return self.out / "runs" / name

    @property
    def policy(self) -> Path:
        """File of the policy."""
        return self.out / "policies" / f"{self.path.stem}.npz"

    def find(self) -> LearnerRun | None:
        """Return the training with its episodes, None if it is missing."""
        if not (self.path.exists() and self.policy.exists()):
            return None
        # Episodes in the file, which earlier versions have written, may be of other physics.
        return msgspec.structs.replace(read_json(self.path, _FILE, LearnerRun), drives=self.drives)

    def train(self) -> None:
        """Train, evaluate on the grid and keep both; one at a time, as the time is measured."""
        curve: list[Milestone] = []

        def training(task: str, done: float, total: float | None, state: str = "") -> None:
            name = f"{self.scenario.name} {self.learner}, seed {self.seed}"
            self.progress(name, done, total, state)

        began = time.perf_counter()
        policy = train(self._config, training, curve.append)
        seconds = time.perf_counter() - began
        policy.save(self.policy)
        grid = measure(self.path.stem, policy)
        run = LearnerRun(
            scenario=self.scenario.name,
            learner=self.learner,
            seed=self.seed,
            seconds=seconds,
            curve=tuple(curve),
            grid=msgspec.convert(grid, PolicyMeasures, from_attributes=True),
        )
        write_json(self.path, run)

    def line(self, episodes: int) -> StudyLine:
        """Return the episodes that its policy is to drive."""
        physics = SimulationOptions(through=_through(self.learner, self.scenario))
        case = case_of(load_policy(self.policy), physics, self.seed, progress=self.progress)
        return StudyLine(case, case.sample(min(episodes, len(case.starts))))


def _through(learner: Learner, scenario: Scenario) -> bool:
    """Return whether a learner's robots drive through cells, as in the moves it learnt on."""
    moves = moves_of(learner, scenario)
    return moves is not None and moves.through


@cache
def _least_times(scenario: Scenario, through: bool) -> np.ndarray:
    """(K,) float64 in s, of all starts; see `agent.moves.bound`."""
    moves = method_config("pair" if through else "moves", scenario).moves
    assert moves is not None
    process = build_process(scenario, ProcessConfig())
    return least_times_of_starts(process, moves, joint_starts(process))


def left_out(scenario: Scenario, learner: Learner) -> str | None:
    """Return why a learner is not in the table of a scenario; None if it is."""
    if learner == "pair" and scenario.robots != 2:
        return "n/a: not two robots"
    if learner in COMPUTED and optimum(build_process(scenario, ProcessConfig())).relaxed:
        cells = scenario.columns * scenario.rows
        return f"n/a: {cells**scenario.robots:.1g} joint states"
    return None


def baselines(
    out: Path,
    *,
    scenarios: Collection[str],
    learners: Collection[Learner],
    seed: int,
    seeds: int,
    episodes: int,
    quick: bool = False,
    budget_minutes: float | None = None,
    where: Workers = Workers(),  # noqa: B008 - a constant
    progress: Progress = silent,
) -> BaselinesReport:
    """Train and simulate missing results, and write the table.

    Seed by seed: a budget that is used up leaves out seeds, not learners. Arguments are options of
    the command.
    """
    in_time, store = until(budget_minutes), EpisodeStore(out / "episodes")
    boards = [find_scenario(name, ideal=True) for name in scenarios]
    for name in {board.name for board in boards}:
        if len({board for board in boards if board.name == name}) > 1:
            raise UserError(f"--scenarios has two boards called {name}; rename one (`name = ...`)")
    asked: list[tuple[Scenario, Learner]] = [
        (board, learner) for board in boards for learner in LEARNERS if learner in learners
    ]
    reasons = {key: left_out(*key) for key in asked}
    trainings = {
        (number, *key): _Training(out, *key, number, quick, progress)
        for number, key in product(range(seed, seed + seeds), asked)
        if reasons[key] is None
    }
    for number in range(seed, seed + seeds):
        now = [training for (of, *_), training in trainings.items() if of == number]
        for training in now:
            if in_time() and training.find() is None:
                training.train()
        trained = [training for training in now if training.find()]
        lines = [training.line(episodes) for training in trained]
        simulate(lines, store, where, may_begin=in_time, progress=progress)
        for training, line in zip(trained, lines, strict=True):
            training.drives = _drives(
                training, store.file(line.case).completed_prefix(line.indices)
            )
    rows = []
    for key in asked:
        found = [training.find() for (_, *of), training in trainings.items() if tuple(of) == key]
        rows.append((key[0].name, key[1], [run for run in found if run], reasons[key]))
    report = report_of(rows, seeds, episodes, seed=seed, quick=quick)
    write_report(out / "baselines", report, markdown(COLUMNS, report.rows))
    return report


def _drives(training: _Training, results: Mapping[int, EpisodeResult]) -> tuple[Drive, ...]:
    """Return the stored values of a training's episodes, by index of the start."""
    if not results:
        return ()
    least = _least_times(training.scenario, _through(training.learner, training.scenario))
    return tuple(
        Drive(index, result.outcome, result.sim_time_s, float(least[index]))
        for index, result in results.items()
    )

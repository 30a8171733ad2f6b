"""Trains the learners of the table seed by seed, and lets their policies drive in the dynamics.

Every training and every episode is kept as it ends. The learners are `agent.baselines.learners`,
the table `agent.baselines.table`.
"""

import time
from collections.abc import Callable, Collection
from functools import cache
from pathlib import Path

import msgspec
import numpy as np

from agent.baselines import LEARNERS, Learner
from agent.baselines.learners import config_of, digest, train
from agent.baselines.table import (
    MARKDOWN_FILE,
    TABLE_FILE,
    BaselinesReport,
    Drive,
    LearnerRun,
    markdown,
    report_of,
)
from agent.evaluation.cases import Case, run_jobs
from agent.evaluation.dynamics import tracked
from agent.evaluation.grid import PolicyMeasures, measure
from agent.evaluation.result_file import ResultFile
from agent.method import ON_MOVES, method_config
from agent.moves.bound import least_times_of_starts
from agent.policies import load_policy
from agent.process.config import ProcessConfig
from agent.process.exact import Milestone, joint_starts
from agent.process.optimum import optimum
from agent.process.readings import build_process
from agent.training.settings import COMPUTED
from cosim.base.errors import UserError
from cosim.base.progress import Progress, silent
from cosim.base.reading import Kind, read_json
from cosim.base.storage import replacing, write_json
from cosim.navigation.options import Driving
from cosim.scenarios.file import find_scenario
from cosim.scenarios.scenario import Scenario

_FILE = Kind("file of a training", "remove it", UserError)


class _Runs:
    """Trainings of one session of the command, and where they are kept."""

    def __init__(self, out: Path, quick: bool, progress: Progress) -> None:
        self._out, self._quick, self._progress = out, quick, progress
        self._paths: dict[tuple[str, Learner, int], Path] = {}
        self._drives: dict[Path, tuple[Drive, ...]] = {}

    def path(self, scenario: Scenario, learner: Learner, seed: int) -> Path:
        """File of a training, written when it has ended."""
        key = scenario.name, learner, seed
        if key not in self._paths:
            config = config_of(learner, scenario, seed, self._quick, self._progress)
            name = f"{scenario.name}-{learner}-{seed}-{digest(config)}.json"
            self._paths[key] = self._out / "runs" / name
        return self._paths[key]

    def _policy(self, path: Path) -> Path:
        return self._out / "policies" / f"{path.stem}.npz"

    def find(self, scenario: Scenario, learner: Learner, seed: int) -> LearnerRun | None:
        """Return a training that is there, with the episodes that `drive` has found of it."""
        path = self.path(scenario, learner, seed)
        if not (path.exists() and self._policy(path).exists()):
            return None
        run = read_json(path, _FILE, LearnerRun)
        # Those in the file, which earlier versions have written, may be of other physics.
        return msgspec.structs.replace(run, drives=self._drives.get(path, ()))

    def train(self, scenario: Scenario, learner: Learner, seed: int) -> None:
        """Train, evaluate on the grid and keep both."""
        curve: list[Milestone] = []

        def training(task: str, done: float, total: float | None, state: str = "") -> None:
            self._progress(f"{scenario.name} {learner}, seed {seed}", done, total, state)

        began = time.perf_counter()
        config = config_of(learner, scenario, seed, self._quick, self._progress)
        policy = train(config, training, curve.append)
        seconds = time.perf_counter() - began
        path = self.path(scenario, learner, seed)
        path.parent.mkdir(parents=True, exist_ok=True)
        policy.save(self._policy(path))
        grid = msgspec.convert(measure(path.stem, policy), PolicyMeasures, from_attributes=True)
        run = LearnerRun(
            scenario=scenario.name,
            learner=learner,
            seed=seed,
            seconds=seconds,
            curve=tuple(curve),
            grid=grid,
        )
        write_json(path, run)

    def drive(
        self,
        keys: list[tuple[Scenario, Learner, int]],
        episodes: int,
        jobs: int,
        may_begin: Callable[[], bool],
    ) -> None:
        """Simulate what is missing of the episodes of trainings, for `find` to show."""
        files = {key: self._file(*key) for key in keys if self.find(*key) is not None}
        indices = {
            key: file.case.sample(min(episodes, len(file.case.starts)))
            for key, file in files.items()
        }
        missing = [job for key, file in files.items() for job in file.missing(indices[key])]
        by_digest = {file.case.digest: file for file in files.values()}
        ended = run_jobs(missing, jobs, may_begin)
        for job, result in tracked(ended, len(missing), self._progress, "episodes"):
            by_digest[job.case.digest].add(job.index, result)
        for key, file in files.items():
            if known := file.beginning(indices[key]):
                scenario, learner, _ = key
                least = _least_times(scenario, _through(learner))
                self._drives[self.path(*key)] = tuple(
                    Drive(index, result.outcome, result.sim_time_s, float(least[index]))
                    for index, result in known.items()
                )

    def _file(self, scenario: Scenario, learner: Learner, seed: int) -> ResultFile:
        policy = load_policy(self._policy(self.path(scenario, learner, seed)))
        driving = Driving(through=_through(learner))
        config, fmu = driving.prepare(scenario.robot_diameter_m, self._progress)
        return ResultFile(self._out / "episodes", Case(policy, config, fmu, seed))


def _through(learner: Learner) -> bool:
    """Whether a learner's robots drive through cells, as in the moves that they learnt on."""
    return learner in ON_MOVES and ON_MOVES[learner].through


@cache
def _least_times(scenario: Scenario, through: bool) -> np.ndarray:
    """(K,) float64 in s, of all starts; see `agent.moves.bound`."""
    moves = method_config("prompt" if through else "moves", scenario).moves
    assert moves is not None
    process = build_process(scenario, ProcessConfig())
    return least_times_of_starts(process, moves, joint_starts(process))


def left_out(scenario: Scenario, learner: Learner) -> str | None:
    """Why a learner is not in the table of a scenario, if so."""
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
    jobs: int = 2,
    progress: Progress = silent,
) -> BaselinesReport:
    """Train and simulate what is missing, and write the table.

    Seed by seed: a budget that is used up leaves out seeds, not learners.

    Args:
        out: folder of the table (baselines.json, baselines.md), trainings and episodes.
        scenarios: names or files.
        learners: to compare.
        seed: the first one, of training and of what episodes draw.
        seeds: how many.
        episodes: in the dynamics, of every training.
        quick: train so little that it only shows that it works.
        budget_minutes: after which no training and no episode is begun.
        jobs: threads of episodes; the results do not depend on it.
        progress: is told what is trained and simulated.

    Returns:
        The content of baselines.json.

    Raises:
        UserError: see its message.
    """
    end = None if budget_minutes is None else time.monotonic() + 60.0 * budget_minutes
    boards = [find_scenario(name, ideal=True) for name in scenarios]
    for name in {board.name for board in boards}:
        if len({board for board in boards if board.name == name}) > 1:
            raise UserError(f"--scenarios has two boards called {name}; rename one (`name = ...`)")
    runs = _Runs(out, quick, progress)
    numbers = range(seed, seed + seeds)

    def in_time() -> bool:
        return end is None or time.monotonic() < end

    asked: list[tuple[Scenario, Learner]] = [
        (board, learner) for board in boards for learner in LEARNERS if learner in learners
    ]
    reasons = {(board.name, learner): left_out(board, learner) for board, learner in asked}
    for number in numbers:
        keys: list[tuple[Scenario, Learner, int]] = [
            (board, learner, number)
            for board, learner in asked
            if reasons[board.name, learner] is None
        ]
        for key in keys:
            if in_time() and runs.find(*key) is None:
                runs.train(*key)
        runs.drive(keys, episodes, jobs, in_time)
    rows = []
    for board, learner in asked:
        reason = reasons[board.name, learner]
        known = [runs.find(board, learner, number) for number in numbers] if reason is None else []
        rows.append((board.name, learner, [run for run in known if run is not None], reason))
    report = report_of(rows, seeds, episodes, seed=seed, quick=quick)
    write_json(out / TABLE_FILE, report)
    with replacing(out / MARKDOWN_FILE) as temporary:
        temporary.write_text(markdown(report) + "\n", encoding="utf-8")
    return report

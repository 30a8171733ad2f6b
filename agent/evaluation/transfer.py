"""How policies trained by each method succeed in the full dynamics: the table of docs/transfer.md.

What an episode is stands in `agent.evaluation.cases`, the table itself in
`agent.evaluation.transfer_table`; the command line is `cosim.transfer`.
"""

import time
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path

from agent.evaluation.cases import Case, run_jobs
from agent.evaluation.dynamics import tracked
from agent.evaluation.result_file import ResultFile
from agent.evaluation.transfer_table import Row, Session, TransferReport, markdown, report_of
from agent.method import method_policy
from agent.process.greedy import GreedyPolicy
from agent.training.settings import BEST, COMPARED, METHODS
from cosim.base.errors import UserError
from cosim.base.params import TABLE_I
from cosim.base.progress import Progress, silent
from cosim.base.reading import Kind, read_json
from cosim.base.storage import replacing, write_json
from cosim.navigation.options import Driving
from cosim.scenarios.built_in import PAPER
from cosim.scenarios.file import find_scenario

TABLE_FILE, MARKDOWN_FILE, SESSIONS_FILE = "transfer.json", "transfer.md", "sessions.json"
MUS = (TABLE_I.mu, 0.1, 0.2)  # most important first
# Episodes of a pair in rows of the best method at the default friction, and of all other rows.
_MANY, _SOME, QUICK_EPISODES = 200, 50, 2
_SESSIONS = Kind("list of sessions", "remove it", UserError)


def _read_sessions(path: Path) -> list[Session]:
    return read_json(path, _SESSIONS, list[Session]) if path.exists() else []


@dataclass
class Measurement:
    """The table while it is made.

    Attributes:
        out: folder of the table, policies and results.
        seed: of training, of samples of starts and of the speed noise.
        quick: whether rows have two episodes only.
        jobs: threads.
        progress: is told what is trained and simulated.
        end: `time.monotonic` after which no episode is started, if any.
        rows: so far.
        sessions: runs of the command that simulated something, this one last.
    """

    out: Path
    seed: int
    quick: bool
    jobs: int
    progress: Progress
    end: float | None
    rows: list[Row] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.sessions = _read_sessions(self.out / SESSIONS_FILE)
        self._began, self._simulated = time.monotonic(), 0
        self._policies: dict[tuple[str, str], GreedyPolicy] = {}

    def add_rows(self, scenarios: Iterable[str], method: str, mu: float) -> list[Row]:
        """Rows of all scenarios; trains what has not been trained yet."""
        rows: list[Row] = []
        for name, shield in product(scenarios, (False, True)):
            policy, driving = self._policy(method, name), Driving(mu=mu, shield=shield)
            scenario = policy.config.scenario
            config, fmu = driving.prepare(scenario.robot_diameter_m, self.progress)
            case = Case(policy, config, fmu, self.seed)
            indices = case.sample(self._count(case, method, mu))
            file = ResultFile(self.out / "results", case)
            rows.append(Row(scenario.name, method, mu, indices, file))
        self.rows += rows
        return rows

    def _policy(self, method: str, scenario: str) -> GreedyPolicy:
        key = method, scenario
        if key not in self._policies:
            policy, *_ = method_policy(
                method, find_scenario(scenario, ideal=True), self.seed, progress=self.progress
            )
            file = f"{policy.config.scenario.name}-{method}.npz"
            policy.save(self.out / "policies" / file)
            self._policies[key] = policy
        return self._policies[key]

    def _count(self, case: Case, method: str, mu: float) -> int | None:
        available = len(case.starts)
        if self.quick:
            return min(QUICK_EPISODES, available)
        if method != BEST or mu != TABLE_I.mu or case.config.shield:
            return min(_SOME, available)
        return None if case.policy.config.scenario.robots == 1 else min(_MANY, available)

    def simulate(self, rows: list[Row]) -> None:
        """Simulate what is missing of rows."""
        files = {row.file.case.digest: row.file for row in rows}
        jobs = [job for row in rows for job in row.file.missing(row.indices)]
        episodes = run_jobs(jobs, self.jobs, self._in_time)
        what = f"{rows[0].method}, µ = {rows[0].mu:g}"
        for job, result in tracked(episodes, len(jobs), self.progress, what):
            files[job.case.digest].add(job.index, result)
            self._keep_time()

    def _keep_time(self) -> None:
        """Count an episode; kept at once, as a killed process has no later chance."""
        self._simulated += 1
        session = Session(
            elapsed_s=time.monotonic() - self._began, episodes=self._simulated, jobs=self.jobs
        )
        self.sessions[len(self.sessions) - (self._simulated > 1) :] = [session]
        write_json(self.out / SESSIONS_FILE, self.sessions)

    def _in_time(self) -> bool:
        return self.end is None or time.monotonic() < self.end


def transfer(
    out: Path,
    *,
    scenarios: Collection[str] = tuple(PAPER),
    methods: Collection[str] = COMPARED,
    seed: int = 0,
    quick: bool = False,
    budget_minutes: float | None = None,
    jobs: int = 2,
    progress: Progress = silent,
) -> TransferReport:
    """Simulate what is missing and write the table.

    Args:
        out: folder of the table (transfer.json, transfer.md), policies and results.
        scenarios: to measure.
        methods: to measure.
        seed: of training, of samples of starts and of the speed noise.
        quick: two episodes in every row.
        budget_minutes: after which no episode is started.
        jobs: threads; the results do not depend on it.
        progress: is told what is trained and simulated.

    Returns:
        The content of transfer.json.

    Raises:
        UserError: see its message.
    """
    end = None if budget_minutes is None else time.monotonic() + 60.0 * budget_minutes
    measurement = Measurement(out, seed, quick, jobs, progress, end)
    for method in METHODS:
        if method in methods:
            for mu in MUS if method == BEST else MUS[:1]:
                measurement.simulate(measurement.add_rows(scenarios, method, mu))
    report = report_of(measurement.rows, measurement.sessions)
    write_json(out / TABLE_FILE, report)
    with replacing(out / MARKDOWN_FILE) as temporary:
        temporary.write_text(markdown(report) + "\n", encoding="utf-8")
    return report

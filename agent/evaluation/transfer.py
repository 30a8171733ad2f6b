"""`python -m cosim.transfer`: how many episodes of the full dynamics succeed, by method.

Makes the table of docs/transfer.md: scenarios, methods, friction coefficients, with and
without the safety layer. What an episode is stands in `agent.evaluation.cases`, the table itself in
`agent.evaluation.transfer_table`.
"""

import json
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

from agent.evaluation.cases import Case, Job, run_jobs
from agent.evaluation.dynamics import tracked
from agent.evaluation.result_file import ResultFile
from agent.evaluation.transfer_table import Row, markdown, report_of, show
from agent.methods import BEST, METHODS, Method, method_policy
from agent.training.policy import Policy
from cosim.base.config import ConfigError, CoSimConfig
from cosim.base.errors import UserError, run_command
from cosim.base.params import SAFETY_MARGIN_M, TABLE_I
from cosim.base.reading import Kind, read_json
from cosim.base.scenario import BUILT_IN, find_scenario
from cosim.base.storage import replacing
from cosim.navigation.calibration_cache import calibrated
from fmus.build import cached_fmu

TABLE_FILE, MARKDOWN_FILE, SESSIONS_FILE = "transfer.json", "transfer.md", "sessions.json"
MUS = (TABLE_I.mu, 0.1, 0.2)  # most important first
# Episodes of a pair in rows of the best method at the default friction, and of all other rows.
_MANY, _SOME, _QUICK = 200, 50, 2
_SESSIONS = Kind("list of sessions", "remove it", UserError)


@dataclass(frozen=True)
class Transfer:
    """Measure how policies trained by different methods succeed in the full co-simulation.

    Rows are scenarios 1a to 4, methods, friction coefficients, and the safety layer off
    and on; the most important ones come first. Every episode is kept as it comes: the same command
    goes on where an earlier one ended, and writes the table of what is there at any time.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/transfer")
    """Folder of the table (transfer.json, transfer.md), policies and results."""
    quick: bool = False
    """Two episodes in every row instead of all starts, 200 or 50: to see that it works."""
    budget_minutes: Annotated[float | None, tyro.conf.arg(metavar="M")] = None
    """Start no episode after so many minutes; rows then have as much of the beginning of their
    samples as is there."""
    scenarios: tuple[str, ...] = tuple(BUILT_IN)
    """Scenarios to measure, built in or files (.toml)."""
    methods: tuple[Method, ...] = METHODS
    """Methods to measure; see `python -m cosim.run --help`."""
    seed: int = 0
    """Seed of training, of samples of starts and of the speed noise."""
    jobs: int = 2
    """Episodes to co-simulate at the same time, in threads; the results do not depend on it."""
    json: bool = False
    """Print the content of transfer.json as the last line of output."""

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise ConfigError("--jobs must be at least 1")
        if self.seed < 0:
            raise ConfigError("--seed must not be negative")
        if self.budget_minutes is not None and self.budget_minutes < 0.0:
            raise ConfigError("--budget-minutes must not be negative")
        for name in self.scenarios:
            find_scenario(name)

    def phases(self) -> list[tuple[Method, float]]:
        """Method and friction coefficient of groups of rows, most important first."""
        mus = {method: MUS if method == BEST else MUS[:1] for method in METHODS}
        return [(method, mu) for method in METHODS if method in self.methods for mu in mus[method]]


def _read_sessions(path: Path) -> list[dict[str, float]]:
    return read_json(path, _SESSIONS, list[dict[str, float]]) if path.exists() else []


class Measurement:
    """The table while it is made.

    Attributes:
        rows: so far.
        sessions: elapsed time, episodes and jobs of every run of the command that simulated
            something, this one last.

    Raises:
        UserError: the folder has times that are none.
    """

    def __init__(self, options: Transfer, console: Console) -> None:
        self.options = options
        self.rows: list[Row] = []
        self._times = options.out / SESSIONS_FILE
        self.sessions = _read_sessions(self._times)
        self._began, self._simulated = time.monotonic(), 0
        self._fmu = cached_fmu()
        self._console = console
        budget = options.budget_minutes
        self._end = None if budget is None else time.monotonic() + 60.0 * budget
        self._policies: dict[tuple[Method, str], Policy] = {}

    def add_rows(self, method: Method, mu: float) -> list[Row]:
        """Rows of all scenarios; trains what has not been trained yet."""
        rows: list[Row] = []
        for name in self.options.scenarios:
            policy = self._policy(method, name)
            config = CoSimConfig(robot=TABLE_I._replace(mu=mu))
            config = config.sized(policy.config.scenario.robot_diameter_m)
            config = calibrated(config, self._fmu, self._console)
            cases = [
                Case(
                    policy,
                    replace(config, safety_margin_m=margin_m),
                    self._fmu,
                    self.options.seed,
                )
                for margin_m in (0.0, SAFETY_MARGIN_M)
            ]
            indices = cases[0].sample(self._count(cases[0], method, mu))
            files = [ResultFile(self.options.out / "results", case) for case in cases]
            scenario = policy.config.scenario.name
            rows.append(Row(scenario, method, mu, indices, *files))
        if not self.rows:
            rows[0].off.case.system().compile()
        self.rows += rows
        return rows

    def _policy(self, method: Method, scenario: str) -> Policy:
        key = method, scenario
        if key not in self._policies:
            with self._console.status(f"training ({method}) for scenario {scenario}"):
                policy, *_ = method_policy(method, find_scenario(scenario), self.options.seed)
            file = f"{policy.config.scenario.name}-{method}.npz"
            policy.save(self.options.out / "policies" / file)
            self._policies[key] = policy
        return self._policies[key]

    def _count(self, case: Case, method: Method, mu: float) -> int | None:
        available = len(case.starts)
        if self.options.quick:
            return min(_QUICK, available)
        if method != BEST or mu != TABLE_I.mu:
            return min(_SOME, available)
        return None if case.policy.config.scenario.robots == 1 else min(_MANY, available)

    def simulate(self, rows: list[Row]) -> None:
        """Simulate what is missing of rows, without the safety layer and then with it."""
        for safety in (False, True):
            files = {file.case.digest: file for row in rows for file in (row.off, row.on)}
            jobs = [job for row in rows for job in row.missing(safety)]
            episodes = run_jobs(self._in_time(jobs), self.options.jobs)
            layer = "with" if safety else "without"
            what = f"{rows[0].method}, µ = {rows[0].mu:g}, {layer} safety layer"
            for job, result in tracked(episodes, len(jobs), self._console, what):
                files[job.case.digest].add(job.index, result)
                self._keep_time()

    def _keep_time(self) -> None:
        """Count an episode; kept at once, as a killed process has no later chance."""
        self._simulated += 1
        session = {
            "elapsed_s": time.monotonic() - self._began,
            "episodes": self._simulated,
            "jobs": self.options.jobs,
        }
        self.sessions[len(self.sessions) - (self._simulated > 1) :] = [session]
        _write(self._times, json.dumps(self.sessions))

    def _in_time(self, jobs: Iterable[Job]) -> Iterator[Job]:
        for job in jobs:
            if self._end is not None and time.monotonic() >= self._end:
                return
            yield job


def transfer(options: Transfer, console: Console) -> dict[str, Any]:
    """Simulate what is missing and write the table.

    Args:
        options: the command line.
        console: for progress; nothing is drawn if it is no terminal.

    Returns:
        The content of transfer.json.

    Raises:
        UserError: see its message.
    """
    measurement = Measurement(options, console)
    for method, mu in options.phases():
        measurement.simulate(measurement.add_rows(method, mu))
    report = report_of(measurement.rows, measurement.sessions)
    _write(options.out / TABLE_FILE, json.dumps(report, indent=1))
    _write(options.out / MARKDOWN_FILE, markdown(report))
    return report


def _write(path: Path, content: str) -> None:
    with replacing(path) as temporary:
        temporary.write_text(content + "\n", encoding="utf-8")


def main() -> None:
    """Command line; see `Transfer`."""
    options = tyro.cli(
        Transfer, prog="python -m cosim.transfer", config=(tyro.conf.FlagCreatePairsOff,)
    )
    stderr, stdout = Console(stderr=True), Console()
    try:
        report = transfer(options, stderr)
    except KeyboardInterrupt:
        stderr.print(f"episodes so far are in {options.out}/; the same command goes on")
        raise
    show(report, stdout)
    stdout.print(f"table in {options.out}/: {TABLE_FILE}, {MARKDOWN_FILE}", soft_wrap=True)
    if options.json:
        print(json.dumps(report))


if __name__ == "__main__":
    run_command(main)

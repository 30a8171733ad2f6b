"""Simulates the episodes of the robustness table, and keeps each as it comes.

The worlds are `agent.robustness.axes`, the table `agent.robustness.table`; the command line is
`cosim.robustness`.
"""

import time
from collections.abc import Collection, Iterator
from pathlib import Path

from agent.evaluation.cases import Case, run_jobs
from agent.evaluation.dynamics import tracked
from agent.evaluation.result_file import ResultFile
from agent.method import method_policy
from agent.process.greedy import GreedyPolicy
from agent.robustness.axes import AXES, Axis, AxisPoint, points
from agent.robustness.plot import PLOT_FILE, draw
from agent.robustness.table import (
    MARKDOWN_FILE,
    TABLE_FILE,
    MeasuredRow,
    RobustnessReport,
    markdown,
    report_of,
)
from agent.training.settings import IN_WORLDS
from cosim.base.progress import Progress, silent
from cosim.base.storage import replacing, write_json
from cosim.base.world import World
from cosim.navigation.options import Driving
from cosim.scenarios.file import find_scenario, in_world

EPISODES, QUICK_EPISODES = 50, 2


def robustness(
    out: Path,
    everything: World,
    *,
    scenario: str = "4",
    axes: Collection[Axis] = AXES,
    methods: Collection[str] = IN_WORLDS,
    episodes: int = EPISODES,
    seed: int = 0,
    budget_minutes: float | None = None,
    jobs: int = 2,
    progress: Progress = silent,
) -> RobustnessReport:
    """Simulate what is missing of the table, and write it.

    Args:
        out: folder of the table, policies and results.
        everything: the world in which nothing is ideal.
        scenario: name or file.
        axes: to measure.
        methods: to measure.
        episodes: of every row.
        seed: of training, of the sample of starts and of what episodes draw.
        budget_minutes: after which no episode is started.
        jobs: threads; the results do not depend on it.
        progress: is told what is trained and simulated.

    Returns:
        The content of robustness.json.

    Raises:
        UserError: see its message.
    """
    end = None if budget_minutes is None else time.monotonic() + 60.0 * budget_minutes
    policies = {m: _policy(m, scenario, seed, out, progress) for m in IN_WORLDS if m in methods}
    board = find_scenario(scenario, ideal=True)
    files: dict[str, ResultFile] = {}
    rows = [
        row
        for axis in AXES
        if axis in axes
        for point in points(axis, board, everything)
        for row in _rows(point, policies, episodes, seed, out, files, progress)
    ]
    # all at once: episodes in different worlds share batches, and rows of the same world episodes
    missing = list({j.key: j for row in rows for j in row.file.missing(row.indices)}.values())
    ended = run_jobs(missing, jobs, lambda: end is None or time.monotonic() < end)
    for job, result in tracked(ended, len(missing), progress, "episodes"):
        files[job.case.digest].add(job.index, result)
    report = report_of(scenario, rows)
    write_json(out / TABLE_FILE, report)
    with replacing(out / MARKDOWN_FILE) as temporary:
        temporary.write_text(markdown(report) + "\n", encoding="utf-8")
    with replacing(out / PLOT_FILE) as temporary:
        draw(report).savefig(temporary, format="png", dpi=150)
    return report


def _policy(method: str, scenario: str, seed: int, out: Path, progress: Progress) -> GreedyPolicy:
    policy, *_ = method_policy(method, find_scenario(scenario), seed, progress=progress)
    policy.save(out / "policies" / f"{policy.config.scenario.name}-{method}.npz")
    return policy


def _rows(
    point: AxisPoint,
    policies: dict[str, GreedyPolicy],
    episodes: int,
    seed: int,
    out: Path,
    files: dict[str, ResultFile],
    progress: Progress,
) -> Iterator[MeasuredRow]:
    """Rows of a world: every method, where nothing is ideal also with the shield."""
    for method, policy in policies.items():
        scenario = policy.config.scenario
        policy.require_scenario(in_world(scenario, point.world))
        for shield in (False, True) if point.axis == "everything" else (False,):
            driving = Driving(shield=shield)
            config, fmu = driving.prepare(scenario.robot_diameter_m, progress, point.world)
            case = Case(policy, config, fmu, seed)
            indices = case.sample(min(episodes, len(case.starts)))
            if case.digest not in files:
                files[case.digest] = ResultFile(out / "results", case)
            yield MeasuredRow(point, method, indices, files[case.digest])

"""Tables for the terminal: what a search has found, and what became of its cases."""

from collections.abc import Sequence

from agent.falsification.falsify import FalsificationReport
from agent.falsification.found import FoundCase, ReplayReport
from cosim.base.command import show_table
from cosim.base.errors import in_shell
from cosim.base.table import known

_CASE = ("episode", "starts", "seed", "outcome", "gap", "simulated")


def _cells(case: FoundCase) -> list[str]:
    return [
        str(case.number),
        " ".join(f"({x}, {y})" for x, y in case.starts),
        str(case.seed),
        case.outcome,
        known(case.gap_cm, "{:.3f} cm"),
        f"{case.sim_time_s:.0f} s",
    ]


def show(report: FalsificationReport) -> None:
    """Print the worst episodes, and how many it took to find the first failure."""
    show_table(None, _CASE, [_cells(case) for case in report.worst], title="worst episodes")
    ends = ", ".join(f"{count} {outcome}" for outcome, count in report.outcomes.items())
    after = "an episode without a gap" if report.objective == "gap" else "a time-out"
    first = "none found" if report.first is None else f"the first in episode {report.first - 1}"
    print(f"{report.episodes} episodes ({ends}), {report.found} of them {after}: {first}")
    recordings = [case.recording for case in report.worst if case.recording]
    if recordings:
        print(f"open with: {in_shell('rerun')} {recordings[0]}")


def show_replay(report: ReplayReport) -> None:
    """Print what cases were and are."""
    rows: Sequence[list[str]] = [
        [
            *_cells(then),
            now.outcome,
            known(now.gap_cm, "{:.3f} cm"),
            f"{now.sim_time_s:.0f} s",
            "fails" if now.fails else "holds",
        ]
        for then, now in zip(report.then, report.now, strict=True)
    ]
    header = (*_CASE, "now", "gap now", "simulated now", "")
    show_table(None, header, rows)
    failed = sum(case.fails for case in report.then)
    print(f"{report.failing} of {len(rows)} cases fail, {failed} did when they were found")

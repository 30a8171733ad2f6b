"""Goals of the best method in every scenario and for every friction coefficient."""

import operator
from collections.abc import Iterable

import msgspec

from agent.evaluation.statistics import Interval, interval_text
from agent.study.episodes import EpisodesRow, interval_of

SUCCESS, PATH_RATIO = 0.99, 1.25


class Goal(msgspec.Struct, frozen=True, kw_only=True):
    """The worst value over the rows that a goal is about, where, and whether it holds there."""

    goal: str
    limit: float
    worst: float
    low: float | None
    high: float | None
    scenario: str
    mu: float
    holds: bool

    def finding(self) -> str:
        """Return it as text."""
        form = (3, 1.0, "") if self.goal.startswith("path") else (1, 100.0, "%")
        digits, factor, unit = form
        limit = f"{factor * self.limit:.{digits}f}{unit}"
        worst = interval_text(Interval(self.worst, self.low, self.high), *form)
        verdict = "holds" if self.holds else "does not hold"
        return (
            f"- Goal, {self.goal} ({limit}): {verdict}; the worst row has {worst} "
            f"(scenario {self.scenario}, µ = {self.mu:g})."
        )


def goals(best: Iterable[EpisodesRow]) -> list[Goal]:
    """Return whether each goal holds in the worst of the rows that it is about.

    Args:
        best: rows of the best method.
    """
    measured = (
        ("success without the shield", "success", False, min, SUCCESS),
        ("collisions with the shield", "collision", True, max, 0.0),
        ("path length over the grid's", "path_ratio_to_grid", False, max, PATH_RATIO),
    )
    rows, found = [row for row in best if row.episodes > 0], []
    for goal, measure, shield, worst, limit in measured:
        known = [e for e in rows if e.shield == shield and getattr(e, measure) is not None]
        if not known:
            continue
        row = worst(known, key=operator.attrgetter(measure))
        value = getattr(row, measure)
        _, low, high = interval_of(row, measure)
        found.append(
            Goal(
                goal=goal,
                limit=limit,
                worst=value,
                low=low,
                high=high,
                scenario=row.scenario,
                mu=row.mu,
                holds=value >= limit if worst is min else value <= limit,
            )
        )
    return found

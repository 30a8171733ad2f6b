"""Compare splitting with plain episodes: how often robots come close and collide.

Of a policy that collides often enough for both: the paper's in scenario 4. The episodes have other
seeds than the roots.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import agent
from agent.certification.collisions import ReachedLevel, SplittingReport, estimate_collisions
from agent.evaluation.cases import Case
from agent.evaluation.statistics import rate
from agent.study.episodes import StudyLine, simulate
from agent.study.store import EpisodeStore
from cosim.base.command import show_table
from cosim.base.jobs import Workers
from cosim.base.progress import progress_bars
from cosim.model.outcome import Outcome
from cosim.simulation.options import SimulationOptions, resolve
from cosim.simulation.result import EpisodeResult


@dataclass(frozen=True)
class ComparedLevel:
    """Probability of a gap by both methods; names as in the JSON output.

    Attributes:
        gap_mm: that robots come so close, or touch anything; 0 is a collision.
        plain, low, high: share of the plain episodes, and its 95 % Wilson interval.
        splitting: the estimate.
        overlap: whether its 95 % interval and that of the plain episodes do.
    """

    gap_mm: float
    plain: float
    low: float
    high: float
    splitting: ReachedLevel
    overlap: bool


@dataclass(frozen=True)
class SplittingComparison:
    """Results.

    Attributes:
        episodes: plain ones.
        levels: the last one is the collision.
        splitting: the estimate, and what it took.
    """

    episodes: int
    levels: tuple[ComparedLevel, ...]
    splitting: SplittingReport


def measure(
    scenario: str,
    episodes: int,
    roots: int,
    branches: int,
    gaps: tuple[float, ...],
    seed: int,
    jobs: int,
    out: Path,
) -> SplittingComparison:
    """Rates of all levels; episodes that are in `out` already are not simulated again.

    Raises:
        UserError: the scenario does not exist, or its robots cannot collide.
    """
    policy, where = agent.train(scenario, method="paper"), Workers(jobs=jobs)
    _, config, fmu = resolve(SimulationOptions(), policy.config.scenario)
    plain = Case(policy, config, fmu, seed)
    with progress_bars() as progress:
        splitting = estimate_collisions(
            replace(plain, seed=seed + 1),
            out,
            roots=roots,
            branches=branches,
            gaps_mm=gaps,
            where=where,
            progress=progress,
        )
        store, indices = EpisodeStore(out), plain.rounds(episodes)
        simulate([StudyLine(plain, indices)], store, where, progress=progress)
    plainly = [store.file(plain).results[index] for index in indices]
    levels = tuple(_compared(level, plainly, case=plain) for level in splitting.levels)
    return SplittingComparison(episodes, levels, splitting)


def _compared(level: ReachedLevel, episodes: list[EpisodeResult], case: Case) -> ComparedLevel:
    near_cm = 0.1 * level.gap_mm + 1e2 * case.policy.config.scenario.robot_diameter_m
    reached = sum(
        episode.outcome == Outcome.COLLISION or (episode.min_distance_cm or 0.0) <= near_cm
        for episode in episodes
    )
    share, low, high = rate(reached, len(episodes))
    overlap = low <= level.high and level.low <= high
    return ComparedLevel(level.gap_mm, share, low, high, level, overlap)


def show(found: SplittingComparison) -> None:
    """Print both rates, level by level."""
    of = found.splitting
    header = ("gap", f"{found.episodes} plain episodes", f"{of.roots} roots", "intervals overlap")
    rows = [
        (
            f"{level.gap_mm:g} mm",
            f"{level.plain:.3g} [{level.low:.3g}, {level.high:.3g}]",
            f"{at.probability:.3g} [{at.low:.3g}, {at.high:.3g}]",
            str(level.overlap),
        )
        for level in found.levels
        for at in [level.splitting]
    ]
    show_table(None, header, rows, numbers=3)
    print(f"{of.simulated} episodes of splitting, worth {of.worth:.0f} plain ones")

"""Compare splitting with plain episodes: how often robots come close and collide.

Of a policy that collides often enough for both: the paper's in scenario 4. The episodes have other
seeds than the roots.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import agent
from agent.certification.collisions import ReachedLevel, estimate_collisions
from agent.evaluation.cases import Case
from agent.evaluation.statistics import rate
from agent.study.episodes import StudyLine, simulate
from agent.study.store import EpisodeStore
from cosim.base.command import require_falling
from cosim.base.jobs import Workers
from cosim.base.progress import progress_bars
from cosim.model.outcome import Outcome
from cosim.simulation.options import SimulationOptions, resolve
from cosim.simulation.result import EpisodeResult
from minirobots.options import CommandOptions, Count, Folder, Jobs, Seed


@dataclass(frozen=True, kw_only=True)
class Options(CommandOptions):
    """Hold how often robots come close and collide, by splitting, against plain episodes.

    Of the paper's policy, without the shield. What has been simulated is kept in --out: the same
    command resumes.
    """

    scenario: str = "4"
    """Scenario of two robots or more."""
    episodes: Count = 100
    """Plain episodes."""
    roots: Count = 40
    """Independent episodes that are split."""
    branches: Count = 4
    """Branches that an episode has after a level."""
    gaps: tuple[float, ...] = (10.0, 3.0)
    """Levels: gaps between the robots in mm."""
    seed: Seed = 0
    jobs: Jobs = -1
    out: Folder = Path("runs/splitting")
    """Folder of results."""

    def __post_init__(self) -> None:
        super().__post_init__()

        require_falling(gaps=self.gaps)


def measure(
    scenario: str,
    episodes: int,
    roots: int,
    branches: int,
    gaps: tuple[float, ...],
    seed: int,
    jobs: int,
    out: Path,
) -> dict[str, Any]:
    """Rates of all levels, the last of which is the collision, by plain episodes and by splitting.

    Episodes that are in `out` already are not simulated again.

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
    levels = [_compared(level, plainly, case=plain) for level in splitting.levels]
    found = {name: getattr(splitting, name) for name in ("roots", "simulated", "worth")}
    return {"episodes": episodes, **found, "levels": levels}


def _compared(level: ReachedLevel, episodes: list[EpisodeResult], case: Case) -> dict[str, Any]:
    near_cm = 0.1 * level.gap_mm + 1e2 * case.policy.config.scenario.robot_diameter_m
    reached = sum(
        episode.outcome == Outcome.COLLISION or (episode.min_distance_cm or 0.0) <= near_cm
        for episode in episodes
    )
    share, low, high = rate(reached, len(episodes))
    return {
        "gap_mm": level.gap_mm,
        "plain": (share, low, high),
        "splitting": (level.probability, level.low, level.high),
        "overlap": low <= level.high and level.low <= high,
    }

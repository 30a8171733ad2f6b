"""Compare splitting with plain episodes: how often robots come close and collide.

Of a policy that collides often enough for both: the paper's, without the shield. The episodes have
other seeds than the roots. What has been simulated is kept in --out: the same command resumes.
"""

from dataclasses import replace
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


class Options(CommandOptions):
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


def measure(options: Options) -> dict[str, Any]:
    """Return the rates of all levels, the last of which is the collision."""
    policy, where = agent.train(options.scenario, method="paper"), Workers(jobs=options.jobs)
    _, config, fmu = resolve(SimulationOptions(), policy.config.scenario)
    plain, out = Case(policy, config, fmu, options.seed), options.out
    with progress_bars() as progress:
        splitting = estimate_collisions(
            replace(plain, seed=options.seed + 1),
            out,
            roots=options.roots,
            branches=options.branches,
            gaps_mm=options.gaps,
            where=where,
            progress=progress,
        )
        store, indices = EpisodeStore(out), plain.rounds(options.episodes)
        simulate([StudyLine(plain, indices)], store, where, progress=progress)
    plainly = [store.file(plain).results[index] for index in indices]
    levels = [_compared(level, plainly, case=plain) for level in splitting.levels]
    found = {name: getattr(splitting, name) for name in ("roots", "simulated", "worth")}
    return {"episodes": options.episodes, **found, "levels": levels}


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

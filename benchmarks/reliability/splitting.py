"""Whether splitting finds the rate of collisions that plain episodes find.

Of a policy that collides often enough for both: the paper's in scenario 4. The episodes have other
seeds than the roots.
"""

from dataclasses import asdict, dataclass, replace
from pathlib import Path

import agent
from agent.certification.collisions import SplittingReport, estimate_collisions
from agent.evaluation.cases import Case, Job, run_jobs
from agent.evaluation.dynamics import tracked
from agent.evaluation.result_file import ResultFile
from agent.evaluation.statistics import rate
from cosim.base.command import workers
from cosim.base.outcome import Outcome
from cosim.base.progress import progress_bars
from cosim.navigation.options import Driving


@dataclass(frozen=True)
class SplittingComparison:
    """Results; names as in the JSON output.

    Attributes:
        episodes: plain ones.
        collision, low, high: their rate and its 95 % Wilson interval.
        splitting: the estimate, its 95 % interval, and what it took.
        overlap: whether the intervals do.
    """

    episodes: int
    collision: float
    low: float
    high: float
    splitting: SplittingReport
    overlap: bool


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
    """Both rates; episodes that are in `out` already are not simulated again.

    Raises:
        UserError: the scenario does not exist, or its robots cannot collide.
    """
    policy, threads = agent.train(scenario, method="paper"), workers(jobs)
    config, fmu = Driving().prepare(policy.config.scenario.robot_diameter_m)
    plain = Case(policy, config, fmu, seed)
    with progress_bars() as progress:
        splitting = estimate_collisions(
            replace(plain, seed=seed + 1),
            out,
            roots=roots,
            branches=branches,
            gaps_mm=gaps,
            jobs=threads,
            progress=progress,
        )
        file, indices = ResultFile(out, plain), plain.cover(episodes)
        missing = [Job(plain, index) for index in indices if index not in file.results]
        ended = run_jobs(missing, threads)
        for job, result in tracked(ended, len(missing), progress, "plain episodes"):
            file.add(job.index, result)
    collided = sum(file.results[index].outcome == Outcome.COLLISION for index in indices)
    share, low, high = rate(collided, episodes)
    overlap = low <= splitting.high and splitting.low <= high
    return SplittingComparison(episodes, share, low, high, splitting, overlap)


def show(found: SplittingComparison) -> None:
    """Print both rates."""
    for name, value in asdict(found).items():
        if name != "splitting":
            print(f"{name:10} {value:.4g}")
    of = found.splitting
    print(
        f"splitting  {of.collision:.4g} [{of.low:.4g}, {of.high:.4g}] of {of.roots} roots, "
        f"{of.simulated} episodes, worth {of.worth or 0.0:.0f}"
    )


if __name__ == "__main__":
    from benchmarks.__main__ import run_alone

    run_alone(__file__)

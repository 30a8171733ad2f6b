"""Found episodes: how bad one is, and files of them that are run again as regression cases."""

import math
from pathlib import Path

import msgspec
import numpy as np

from agent.falsification.ranges import ChosenEpisode
from agent.falsification.search import Sought
from agent.mdp.greedy import GreedyPolicy
from cosim.base.errors import UserError
from cosim.base.progress import Progress, silent
from cosim.base.reading import Kind, read_json
from cosim.model.config import CoSimConfig
from cosim.model.outcome import Outcome
from cosim.model.scenario import Cell, Scenario
from cosim.model.world import World
from cosim.simulation.result import EpisodeResult
from cosim.simulation.tasks import Task, simulate_tasks


def gap_cm(result: EpisodeResult, scenario: Scenario) -> float:
    """Smallest gap between two robots in an episode, in cm; infinite for a robot alone.

    It is 0 where robots touched each other or an obstacle, or one left the board; how near they
    came to obstacles and to the board's edge, next to which they start, is not counted.
    """
    if result.outcome == Outcome.OUT_OF_BOARD or result.contact_time_s > 0.0:
        return 0.0
    if result.min_distance_cm is None:
        return math.inf
    return result.min_distance_cm - 100.0 * scenario.robot_diameter_m


def cost(result: EpisodeResult, scenario: Scenario, objective: Sought) -> float:
    """Return what a search minimises: the gap in cm, or the time in s with its sign changed."""
    return gap_cm(result, scenario) if objective == "gap" else -result.sim_time_s


def fails(result: EpisodeResult, scenario: Scenario, objective: Sought) -> bool:
    """Return whether a search looks for such an episode: without a gap, or timed out."""
    if objective == "time":
        return result.outcome == Outcome.TIMEOUT
    return gap_cm(result, scenario) <= 0.0


class FoundCase(msgspec.Struct, frozen=True, kw_only=True):
    """An episode that a search has found.

    Attributes:
        number: of the episode in its search, from 0.
        starts, seed, world: see `agent.falsification.ranges.ChosenEpisode`.
        outcome, sim_time_s: see `cosim.simulation.result.EpisodeResult`.
        gap_cm: see `gap_cm`; None for a robot alone.
        fails: whether it is what the search is after.
        recording: its file, if it is recorded.
    """

    number: int
    starts: tuple[Cell, ...]
    seed: int
    world: World
    outcome: Outcome
    gap_cm: float | None
    sim_time_s: float
    fails: bool
    recording: str | None = None


class FoundCases(msgspec.Struct, frozen=True, kw_only=True):
    """The content of cases.json: what determines a case except for its policy, FMU and the code.

    Attributes:
        scenario: board and robots.
        config: as calibrated; the world of a case replaces its world.
        objective: of the search.
        policy, policy_digest: which failed.
        cases: the worst one first.
    """

    schema_version: int = 1
    scenario: Scenario
    config: CoSimConfig
    objective: Sought
    policy: str
    policy_digest: str
    cases: tuple[FoundCase, ...]


class ReplayReport(msgspec.Struct, frozen=True, kw_only=True):
    """Output of `--replay --json`: cases as they were found and as they are now, in one order."""

    schema_version: int = 1
    then: tuple[FoundCase, ...]
    now: tuple[FoundCase, ...]

    @property
    def failing(self) -> int:
        """Return how many cases fail now."""
        return sum(case.fails for case in self.now)


class CaseFileError(UserError):
    """Invalid file of cases. The message names the file and how to fix it."""


_FILE = Kind("file of cases", "make it with `minirobots falsify`", CaseFileError)


def read_cases(path: Path) -> FoundCases:
    """Cases of a file.

    Raises:
        CaseFileError: it is missing, damaged or another file.
    """
    return read_json(path, _FILE, FoundCases)


def found_case(
    number: int,
    result: EpisodeResult,
    chosen: ChosenEpisode | FoundCase,
    scenario: Scenario,
    objective: Sought,
    recording: Path | None = None,
) -> FoundCase:
    """The case of an episode.

    Args:
        number: of the episode.
        result: of the episode.
        chosen: its seed and its world.
        scenario: of the episode.
        objective: of the search.
        recording: of the episode, if there is one.
    """
    gap = gap_cm(result, scenario)
    return FoundCase(
        number=number,
        starts=result.starts,
        seed=chosen.seed,
        world=chosen.world,
        outcome=result.outcome,
        gap_cm=gap if math.isfinite(gap) else None,
        sim_time_s=result.sim_time_s,
        fails=fails(result, scenario, objective),
        recording=None if recording is None else str(recording),
    )


def run_again(
    found: FoundCases, policy: GreedyPolicy, fmu: Path, threads: int, progress: Progress = silent
) -> tuple[FoundCase, ...]:
    """Simulate cases again: what they are now, in their order.

    Args:
        found: cases of a file.
        policy: acts, that of the search or another one.
        fmu: motor FMU file.
        threads: of the simulation; results do not depend on it.
        progress: receives the number that have ended.

    Raises:
        UserError: the policy is of another scenario, or the FMU cannot be used.
    """
    policy.require_scenario(found.scenario)
    tasks = [
        Task(
            found.scenario,
            fmu,
            found.config.in_world(case.world),
            policy,
            case.starts,
            np.random.SeedSequence(case.seed),
        )
        for case in found.cases
    ]
    ended: dict[int, FoundCase] = {}
    for number, result in simulate_tasks(tasks, threads):
        then = found.cases[number]
        ended[number] = found_case(then.number, result, then, found.scenario, found.objective)
        progress("episodes", len(ended), len(tasks), f"{len(ended)}/{len(tasks)}")
    return tuple(ended[number] for number in sorted(ended))

"""Runs a search over episodes of the co-simulation, and keeps each episode as it comes.

A generation is simulated at once. An interrupted search is asked the same again and told the
results that are kept, so that it resumes as if nothing had happened.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import msgspec
import numpy as np

from agent.evaluation.cases import Case, CaseIdentity, Job
from agent.falsification.found import FoundCase, FoundCases, Sought, cost, fails, found_case
from agent.falsification.ranges import ChosenEpisode, Range, Space
from agent.falsification.search import GENERATION, SearchName, new_search
from agent.falsification.surrogate import surrogate_search
from agent.policies import load_policy
from agent.study.episodes import EPISODES, case_of, record
from agent.study.store import EpisodeStore, ResultFileError
from cosim.base.jobs import Workers, run
from cosim.base.progress import Progress, silent
from cosim.base.reached_code import code_digest
from cosim.base.storage import write_json
from cosim.model.config import ConfigError, CoSimConfig
from cosim.model.scenario import Cell
from cosim.model.scenario_file import read_world
from cosim.model.world import IDEAL
from cosim.simulation.options import SimulationOptions
from cosim.simulation.result import EpisodeResult

REPORT_FILE, CASES_FILE = "falsification.json", "cases.json"


@dataclass(frozen=True)
class SearchedCase(Case):
    """A case whose episodes have the starts, seeds and worlds that a search chooses.

    Attributes:
        space: that it chooses from.
        search: how it chooses.
        objective: what it looks for.
        points: chosen so far, by number of the episode.
    """

    space: Space
    search: SearchName
    objective: Sought
    points: list[ChosenEpisode] = field(default_factory=list)

    @cached_property
    def identity(self) -> CaseIdentity:
        """What decides the result of every episode, the search too."""
        own = super().identity
        searched = {
            "search": self.search,
            "objective": self.objective,
            "generation": float(GENERATION),
        }
        ranges = {f"range of {k}": str(ends) for k, ends in self.space.ranges.items()}
        codes = f"{own.code_digest}-{code_digest(__name__)}"
        parameters = own.parameters | searched | ranges
        return msgspec.structs.replace(own, parameters=parameters, code_digest=codes)

    def start_cells(self, index: int) -> tuple[Cell, ...]:
        """See `Case.start_cells`."""
        return self.points[index].starts

    def config_of(self, index: int) -> CoSimConfig:
        """See `Case.config_of`."""
        return self.config.in_world(self.points[index].world)

    def noise_seed(self, index: int) -> np.random.SeedSequence:
        """See `Case.noise_seed`."""
        return np.random.SeedSequence(self.points[index].seed)


class FalsificationReport(msgspec.Struct, frozen=True, kw_only=True):
    """The content of falsification.json.

    Attributes:
        policy, scenario: what was tested.
        objective, search, seed: of the search.
        ranges: that were searched, by name.
        episodes: simulated.
        first: how many episodes the search needed to find one that it is after; None if it did not.
        found: how many of them it found.
        outcomes: how many episodes ended so, by outcome.
        worst: the worst episodes, the worst one first.
        results: file of all episodes.
    """

    schema_version: int = 1
    policy: str
    scenario: str
    objective: Sought
    search: SearchName
    seed: int
    ranges: dict[str, Range]
    episodes: int
    first: int | None
    found: int
    outcomes: dict[str, int]
    worst: tuple[FoundCase, ...]
    results: str


def falsify(
    policy_file: Path,
    physics: SimulationOptions,
    out: Path,
    *,
    ranges: Mapping[str, Range],
    objective: Sought = "gap",
    search: SearchName = "surrogate",
    episodes: int = 200,
    seed: int = 0,
    until_found: bool = False,
    keep: int = 3,
    jobs: int = 2,
    progress: Progress = silent,
) -> FalsificationReport:
    """Search the worst episodes of a policy, and write what was found.

    Args:
        policy_file: the policy.
        physics: of the co-simulation.
        out: folder of the report, cases, results and recordings.
        ranges: that differ from the default ones, by name.
        objective: the smallest gap, or the longest time.
        search: how to choose episodes.
        episodes: how many, those of earlier runs included.
        seed: of the search.
        until_found: whether to end with the generation in which the first one is found.
        keep: how many of the worst to record.
        jobs: threads; the results do not depend on it.
        progress: receives what is prepared and simulated.

    Returns:
        The content of falsification.json.

    Raises:
        UserError: see its message.
    """
    policy = load_policy(policy_file)
    world = IDEAL if physics.world is None else read_world(physics.world)
    scenario = policy.config.scenario
    if objective == "gap" and scenario.robots == 1:
        raise ConfigError(
            f"scenario {scenario.name} has one robot, which has no gap to another; search for the "
            "longest time (--objective time)"
        )
    name = f"{policy_file}: the policy"
    plain = case_of(policy, physics, seed, world, name=name, progress=progress)
    config, fmu = plain.config, plain.fmu
    case = SearchedCase(
        policy, config, fmu, seed, Space(scenario, config, ranges), search, objective
    )
    store = EpisodeStore(out)
    _simulate(case, store, episodes, until_found=until_found, jobs=jobs, progress=progress)
    file = store.file(case)
    results = {k: file.results[k] for k in range(len(case.points))}
    order = sorted(results, key=lambda k: (cost(results[k], scenario, objective), k))
    failing = [k for k in order if fails(results[k], scenario, objective)]
    recordings = _record(case, store, order[:keep], jobs, progress)
    cases = {k: _case(case, k, results[k], recordings) for k in {*failing, *order[:keep]}}
    kept = FoundCases(
        scenario=scenario,
        config=config,
        objective=objective,
        policy=str(policy_file),
        policy_digest=policy.digest(),
        cases=tuple(cases[k] for k in order if k in cases),
    )
    write_json(out / CASES_FILE, kept)
    outcomes = [str(result.outcome) for result in results.values()]
    report = FalsificationReport(
        policy=str(policy_file),
        scenario=scenario.name,
        objective=objective,
        search=search,
        seed=seed,
        ranges=case.space.ranges,
        episodes=len(results),
        first=1 + min(failing) if failing else None,
        found=len(failing),
        outcomes={name: outcomes.count(name) for name in sorted(set(outcomes))},
        worst=kept.cases[: max(keep, 1)],
        results=str(file.path),
    )
    write_json(out / REPORT_FILE, report)
    return report


def _simulate(
    case: SearchedCase,
    store: EpisodeStore,
    episodes: int,
    *,
    until_found: bool,
    jobs: int,
    progress: Progress,
) -> None:
    """Simulate what is missing of a search."""
    scenario, space = case.policy.config.scenario, case.space
    if case.search == "surrogate":
        search = surrogate_search(space, case.policy, case.fmu, case.objective, case.seed, progress)
    else:
        search = new_search(case.search, space.steps, case.seed)
    least, file = np.inf, store.file(case)
    while len(case.points) < episodes:
        vectors = search.ask()
        numbers = range(len(case.points), min(len(case.points) + GENERATION, episodes))
        case.points.extend(space.point(vector) for vector in vectors[: len(numbers)])
        for _ in run(file.missing(numbers), store, EPISODES, Workers(jobs=jobs)):
            pass
        results = [file.results[k] for k in numbers]
        if any(r.starts != case.start_cells(k) for k, r in zip(numbers, results, strict=True)):
            raise ResultFileError(
                f"{file.path}: the search asked for other episodes on another machine or with "
                "another library; move it away or choose another --out"
            )
        costs = np.array([cost(result, scenario, case.objective) for result in results])
        least = min(least, float(costs.min()))
        worst = f"gap {least:.2f} cm" if case.objective == "gap" else f"time {-least:.0f} s"
        done = len(case.points)
        progress("episodes", done, episodes, f"{done}/{episodes}  {worst}")
        if until_found and any(fails(result, scenario, case.objective) for result in results):
            progress("episodes", episodes, episodes, f"{done}/{episodes}  {worst}")
            return
        if len(numbers) == GENERATION:
            search.tell(vectors, costs)


def _record(
    case: SearchedCase,
    store: EpisodeStore,
    numbers: list[int],
    jobs: int,
    progress: Progress,
) -> dict[int, Path]:
    """Recordings of some episodes, which are made if they are not there."""
    file = store.file(case)
    paths = {
        k: file.path.parent
        / "recordings"
        / f"{file.path.stem}-{k:06d}-{file.results[k].outcome}.rrd"
        for k in numbers
    }
    missing = [Job(case, k, path) for k, path in paths.items() if not path.exists()]
    record(missing, store, jobs, progress)
    return paths


def _case(
    case: SearchedCase, number: int, result: EpisodeResult, recordings: Mapping[int, Path]
) -> FoundCase:
    point, scenario = case.points[number], case.policy.config.scenario
    found = found_case(number, result, (point.seed, point.world), scenario, case.objective)
    path = recordings.get(number)
    return msgspec.structs.replace(found, recording=None if path is None else str(path))

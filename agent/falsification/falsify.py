"""Runs a search over episodes of the co-simulation, and keeps each episode as it comes.

A generation is simulated at once. An interrupted search is asked the same again and given the
results that are kept, so that it resumes as if nothing had happened.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, get_args

import msgspec
import numpy as np

from agent.evaluation.cases import Case, CaseIdentity
from agent.falsification.found import FoundCase, FoundCases, cost, fails, found_case
from agent.falsification.ranges import ChosenEpisode, Range, Space, ranges_of
from agent.falsification.search import GENERATION, SEARCHES, SearchName, Sought, new_search
from agent.falsification.surrogate import surrogate_search
from agent.study.episodes import EPISODES, case_of, record
from agent.study.policies import name_of
from agent.study.store import EpisodeStore, ResultFileError
from cosim.base.arguments import ConfigError, require_one_of, taken, taken_seed
from cosim.base.jobs import Backend, Workers, run
from cosim.base.progress import Progress, automatic, showing, silent
from cosim.base.reached_code import code_digest
from cosim.base.storage import write_json
from cosim.model.config import CoSimConfig
from cosim.model.scenario import Cell
from cosim.simulation.options import options_of

REPORT_FILE, CASES_FILE = "falsification.json", "cases.json"


@dataclass(frozen=True)
class SearchedCase(Case):
    """A case with the starts, seeds and worlds that a search chooses.

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
        """Return what decides the result of every episode, the search too."""
        own = super().identity
        searched = {
            "search": self.search,
            "objective": self.objective,
            "generation": float(GENERATION),
        }
        ranges = {f"range of {k}": str(ends) for k, ends in self.space.ranges.items()}
        codes = f"{own.code_digest}-{code_digest(_simulate, SearchedCase)}"
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


@showing
def falsify(
    policy: Any,
    scenario: Any = None,
    *,
    out: str | Path = Path("runs/falsify"),
    ranges: str | Path | Mapping[str, Range] | None = None,
    objective: Sought = "gap",
    search: SearchName = "surrogate",
    episodes: int = 200,
    seed: int = 0,
    until_found: bool = False,
    keep: int = 3,
    world: Any = None,
    jobs: int = -1,
    backend: Backend = "threads",
    address: str | None = None,
    progress: Progress | None = automatic,
    **options: Any,
) -> FalsificationReport:
    """Search the worst episodes of a policy, and write them as cases that can be run again.

    >>> import minirobots as mr
    >>> policy = mr.train("1a", method="shortest", progress=None)
    >>> few = {"episodes": 8, "keep": 1, "out": "worst", "progress": None}
    >>> report = mr.falsify(policy, objective="time", search="random", time_limit=20, **few)
    >>> report.episodes, report.worst[0].outcome
    (8, <Outcome.TIMEOUT: 'timeout'>)

    Args:
        policy: file, name of a method, "module:Name", or any object with `act(observation)`.
        scenario: name, file or record; by default that of the policy's file.
        out: folder of falsification.json, cases.json, results and recordings, from which the same
            call resumes.
        ranges: to search instead of the default ones, by name, or their file (.toml).
        objective: "gap", the smallest one between two robots, or "time", the longest.
        search: "surrogate", "cma" or "random": how episodes are chosen.
        episodes: how many, those of earlier calls included.
        seed: of training and of the search.
        until_found: end with the generation in which the first failure is found.
        keep: how many of the worst to record.
        world, jobs, backend, address, progress, options: one value each, see `minirobots.study`.

    Returns:
        The content of falsification.json.

    Raises:
        UserError: see its message.
    """
    require_one_of("objective", objective, get_args(Sought))
    require_one_of("search", search, SEARCHES)
    for name, value, least in (("episodes", episodes, 1), ("keep", keep, 0)):
        if taken(name, value, int) < least:
            raise ConfigError(f"{name} = {value} must be at least {least}")
    out, name = Path(out).absolute(), name_of(policy)  # an FMU may change the working directory
    where = Workers(jobs=jobs, backend=backend, address=address)
    report, seed = progress or silent, taken_seed(seed)
    physics, searched = options_of("falsify", options), ranges_of(ranges or {})
    plain = case_of(policy, physics, seed, scenario, world=world, progress=report)
    board, config = plain.policy.config.scenario, plain.config
    if objective == "gap" and board.robots == 1:
        raise ConfigError(
            f"scenario {board.name} has one robot, which has no gap to another; search for the "
            "longest time (--objective time)"
        )
    space = Space(board, config, searched)
    case = SearchedCase(plain.policy, config, plain.fmu, seed, space, search, objective)
    store = EpisodeStore(out)
    _simulate(case, store, episodes, until_found=until_found, where=where, progress=report)
    file = store.file(case)
    results = {k: file.results[k] for k in range(len(case.points))}
    order = sorted(results, key=lambda k: (cost(results[k], board, objective), k))
    failing = [k for k in order if fails(results[k], board, objective)]
    (recordings,) = record([(case, order[:keep])], store, where.count, report)
    cases = [
        found_case(k, results[k], case.points[k], board, objective, recordings.get(k))
        for k in order
        if k in failing or k in recordings
    ]
    kept = FoundCases(
        scenario=board,
        config=config,
        objective=objective,
        policy=name,
        policy_digest=plain.policy.digest(),
        cases=tuple(cases),
    )
    write_json(out / CASES_FILE, kept)
    outcomes = [str(result.outcome) for result in results.values()]
    found = FalsificationReport(
        policy=name,
        scenario=board.name,
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
    write_json(out / REPORT_FILE, found)
    return found


def _simulate(
    case: SearchedCase,
    store: EpisodeStore,
    episodes: int,
    *,
    until_found: bool,
    where: Workers,
    progress: Progress,
) -> None:
    """Simulate the missing episodes of a search."""
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
        for _ in run(file.missing(numbers), store, EPISODES, where):
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

"""A study of one's own: policies, scenarios, worlds and options of the co-simulation as axes.

`study` and `evaluate` are names of `minirobots`, too; docs/studies.md shows them.
"""

import logging
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from agent.evaluation.cases import Case
from agent.evaluation.claims import Claim, claim_of
from agent.evaluation.rows import Row
from agent.mdp.exact import joint_starts
from agent.study.engine import Line, case_of, measure
from agent.study.options import Sampling
from agent.study.policies import name_of, policy_of
from agent.study.report import SUFFIXES, Report
from agent.study.store import EpisodeStore
from cosim.base.arguments import ConfigError, to_plain, validate_argument
from cosim.base.command import record_of
from cosim.base.jobs import until
from cosim.base.progress import Progress, automatic, showing, silent
from cosim.base.reading import Kind, read_toml
from cosim.model.preset import PAPER
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_in_world
from cosim.simulation.options import Physics, options_of

_LOGGER = logging.getLogger(__name__)
_FILE = Kind("study", "see docs/studies.md")
_OF_COMMAND = ("jobs", "backend", "address", "budget_minutes", "progress")


@showing
def study(
    policies: Any,
    scenario: Any = None,
    *,
    episodes: int | None = 50,
    world: Any = None,
    progress: Progress | None = automatic,
    **options: Any,
) -> Report:
    """Measure policies in every combination of scenarios, worlds and options.

    >>> import minirobots as mr
    >>> table = mr.study(["shortest"], "1a", mu=[0.1, 0.15], episodes=1, progress=None)
    >>> print(*(f"{row.options['mu']}: {row.success}" for row in table.rows))
    0.1: 1.0 0.15: 1.0
    >>> table.plot().savefig("success.png")

    Args:
        policies: one or a list, or a dict of them by name: files, names of methods,
            "module:Name", or any objects with `act(observation)`.
        scenario: name, file or record, or a list of them; by default that of every policy's file.
        episodes: of every row, from a sample of starts that all rows of a scenario share; all
            starts where there are fewer, or with a claim these again, each time with other noise;
            None is one from every start.
        world: world file, record or dict of its fields, or a list of them.
        progress: receives what is trained and simulated; by default it is shown on stderr if the
            call takes more than two seconds. None shows nothing.
        options: of a study (`claim`, `confidence`, `seed`, `out`, `jobs`, `backend`, `address`,
            `budget_minutes`), see `agent.study.options`; and of `minirobots run`, such as `mu`,
            `noise`, `speed`, `shield`, of which a list or an array is an axis.

    Returns:
        The table.

    Raises:
        UserError: see its message.
    """
    how, options = record_of(Sampling, options)
    report, judged = progress or silent, claim_of(how.claim, how.confidence)
    scenario = to_plain("scenario", scenario)
    scenarios = scenario if isinstance(scenario, list | tuple) else [scenario]
    folder, named, seed = how.out, _named(policies), how.seed
    if episodes is not None and validate_argument("episodes", episodes, int) < 1:
        raise ConfigError(f"episodes = {episodes} must be at least 1")

    def indices(case: Case) -> list[int]:
        wanted = episodes or len(case.starts)
        return case.rounds(wanted) if judged else case.sample(min(wanted, len(case.starts)))

    given = {"world": world, **options}
    lines = lines_of(named, scenarios, given, seed, indices, judged, report)
    odd = [line.policy for line in lines if not getattr(line.case.policy, "recognizable", True)]
    if folder is not None and odd:
        _LOGGER.warning(
            "%s: its source is in no file or it cannot be pickled; the study's episodes are kept "
            "in memory only and will not be found again",
            ", ".join(dict.fromkeys(odd)),
        )
    store = EpisodeStore(None if folder is None or odd else folder / "results")
    may_begin = until(how.budget_minutes)
    measured = measure(lines, store, how.where, may_begin=may_begin, progress=report)
    rows = tuple(
        msgspec.structs.replace(row, results=line.results(store))
        for row, line in zip(measured, lines, strict=True)
    )
    table = Report(rows=rows, axes=tuple(lines[0].options), seed=seed)
    if folder is not None:
        for suffix in SUFFIXES:
            table.write(folder / f"study{suffix}")
        table.write_episodes(folder / "episodes.parquet")
    return table


def lines_of(
    named: Mapping[str, Any],
    scenarios: Sequence[Any],
    given: Mapping[str, Any],
    seed: int,
    indices: Callable[[Case], list[int]],
    claim: Claim | None,
    progress: Progress,
) -> list[Line]:
    """Return policies by name in every combination of scenarios and options.

    Args:
        named: what `policy_of` takes.
        scenarios: None for that of every policy's file.
        given: `world` and options of `minirobots run`; a list is an axis.
        seed: see `study`.
        indices: of the starts of a case.
        claim: about every row.
        progress: receives what is trained and calibrated.
    """
    given = {name: to_plain(name, value) for name, value in given.items()}
    axes = {name: value for name, value in given.items() if isinstance(value, list)}
    if not (named and scenarios and all(axes.values())):
        raise ConfigError("policies, scenarios and every axis need at least one value each")
    lines: list[Line] = []
    found: dict[tuple[str, Scenario | None, str], Any] = {}
    for board, (name, policy), values in product(scenarios, named.items(), product(*axes.values())):
        chosen = dict(zip(axes, values, strict=True))
        physics = {**given, **chosen}
        world = physics.pop("world")
        setup = options_of("study", physics)
        only = None if board is None else setup.board(find_in_world(board, world)[0])
        key = name, only, str(setup.preset)
        if key not in found:
            training = {"seed": seed, "preset": setup.preset, "progress": progress}
            found[key] = policy_of(policy, only, **training)
        acting = found[key]
        case = case_of(acting, setup, seed, board, world=world, name=name, progress=progress)
        lines.append(Line(case, indices(case), name, chosen, claim))
    return lines


def _named(policies: Any) -> dict[str, Any]:
    """Return policies by name.

    Raises:
        ConfigError: two have one name.
    """
    if isinstance(policies, Mapping):
        return {str(name): policy for name, policy in policies.items()}
    several = policies if isinstance(policies, list | tuple) else [policies]
    named = {name_of(policy): policy for policy in several}
    if len(named) < len(several):
        raise ConfigError(
            f"policies = {', '.join(map(name_of, several))} have equal names; give a dict with a "
            "name for each"
        )
    return named


def read_study(path: Path) -> dict[str, Any]:
    """Return the arguments of `study` that a TOML file has.

    Raises:
        ConfigError: there is no such file, it is no TOML, it names no policies, or it has what is
            an option of the command.
    """
    content = read_toml(path, _FILE)
    if "policies" not in content:
        raise ConfigError(f'{path}: names no policies; add one, such as policies = ["moves"]')
    for name in _OF_COMMAND:
        if name in content:
            option = name.replace("_", "-")
            raise ConfigError(f"{path}: {name} is an option of the command; pass --{option} there")
    return content


def evaluate(
    policy: Any,
    scenario: str | Path | Scenario | None = None,
    *,
    starts: int | None = None,
    claim: str | None = None,
    **options: Any,
) -> Row:
    """Simulate episodes of one policy on all cores, and return what it achieves.

    >>> import minirobots as mr
    >>> class Upwards:
    ...     def act(self, observation):
    ...         return [2] * len(observation.cells)
    >>> row = mr.evaluate(Upwards(), "1a", starts=4, time_limit=40, progress=None)
    >>> row.episodes, row.success, len(row.failures)
    (4, 0.0, 4)
    >>> row = mr.evaluate("shortest", "1a", claim="success > 0.5", confidence=0.6, progress=None)
    >>> row.claim.verdict, row.claim.episodes
    ('certified', 3)

    Args:
        policy: file, name of a method, "module:Name", or any object with `act(observation)`.
        scenario: name, file or record; by default that of the policy's file.
        starts: how many to sample without replacement, by default 20. With a claim by default all,
            and if it is more than there are they begin again, each time with other noise.
        claim: see `study`.
        options: `confidence`, `seed`, `world`, `jobs`, `backend`, `out`, `progress` and others of
            `study`, and those of `minirobots run`, such as `mu`; one value each.

    Returns:
        Rates with their 95 % Wilson intervals, means, `failures`, `results`, which are the episodes
        by index of the start, and `claim`, with its verdict and evidence.

    Raises:
        UserError: see its message.
    """
    if "episodes" in options:
        raise ConfigError("evaluate has no option episodes; give starts, an episode each")
    varying = [name for name, value in options.items() if isinstance(value, list | np.ndarray)]
    if varying or isinstance(policy, list | Mapping) or isinstance(scenario, list | tuple):
        raise ConfigError("evaluate takes one value of each option; study takes several")
    name, episodes = name_of(policy), starts
    if starts is None:
        episodes = None if claim else 20
    elif validate_argument("starts", starts, int) < 1:
        raise ConfigError(f"starts = {starts} must be at least 1")
    elif claim is None:
        board = None if scenario is None else find_in_world(scenario, options.get("world"))[0]
        if board is not None:
            board = Physics(preset=options.get("preset", PAPER)).board(board)
        known = {"seed": options.get("seed", 0), "progress": options.get("progress") or silent}
        policy = policy_of(policy, board, preset=options.get("preset", PAPER), **known)
        if starts > (available := len(joint_starts(policy.process))):
            raise ConfigError(f"starts = {starts}: there are only {available} starts; ask for less")
    (row,) = study({name: policy}, scenario, episodes=episodes, claim=claim, **options).rows
    return row

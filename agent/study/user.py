"""A study of one's own: policies, scenarios, worlds and options of the co-simulation as axes.

`study` and `evaluate` are names of `minirobots`, too; docs/studies.md shows them.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from agent.evaluation.claims import claim_of
from agent.evaluation.rows import Row
from agent.study.engine import lines_of, measure
from agent.study.options import Sampling
from agent.study.policies import name_of
from agent.study.report import SUFFIXES, Report
from agent.study.store import EpisodeStore
from cosim.base.arguments import ConfigError, to_plain, validate_argument
from cosim.base.command import Count, record_of
from cosim.base.jobs import until
from cosim.base.progress import Progress, automatic, showing, silent
from cosim.base.reading import Kind, read_toml
from cosim.model.scenario import Scenario

_FILE = Kind("study", "see docs/studies.md")
_OF_COMMAND = ("jobs", "backend", "address", "budget_minutes", "progress")
STARTS = 50  # of `evaluate`, by default
Table = TypeVar("Table", bound=Report)


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
        policies: one or a list, or a dict of them by name: files, names of methods, dicts of a
            `method` with some of its settings `process` and `learning`, "module:Name", or any
            objects with `act(observation)`.
        scenario: name, file or record, or a list of them; by default that of every policy's file.
        episodes: of every row, from a sample of starts that all rows of a scenario share; all
            starts where there are fewer, or with a claim these again, each time with other noise;
            None is one from every start.
        world: world file, record or dict of its fields, or a list of them, or a dict by name.
        progress: receives what is trained and simulated; by default it is shown on stderr if the
            call takes more than two seconds. None shows nothing.
        options: of a study (`trainings`, `claim`, `confidence`, `seed`, `out`, `jobs`, `backend`,
            `address`, `budget_minutes`), see `agent.study.options`; and of `minirobots run`, such
            as `mu`, `noise`, `speed`, `shield`, of which a list or an array is an axis.

    Returns:
        The table.

    Raises:
        UserError: see its message.
    """
    scenario = to_plain("scenario", scenario)
    scenarios = scenario if isinstance(scenario, list | tuple) else [scenario]
    count = validate_argument("episodes", episodes, Count | None)
    how, given = record_of(Sampling, {"world": world, **options})
    by_name, store = _by_name(policies), _store(how.out)
    table = measured(by_name, scenarios, how, given, count, store, progress or silent)
    return _written(table, how.out)


def measured(
    policies: dict[str, Any],
    scenarios: Sequence[Any],
    how: Sampling,
    given: Mapping[str, Any],
    count: int | None,
    store: EpisodeStore,
    progress: Progress,
    *,
    exactly: bool = False,
    recordings: int = 0,
    episodes: bool = True,
    kind: type[Table] = Report,
) -> Table:
    """Measure what `study`, `evaluate` and the commands are given; return a report of a kind.

    Args:
        policies, scenarios, given, count, exactly: see `lines_of`.
        store: where episodes are kept.
        recordings, episodes: see `measure`.
    """
    claim = claim_of(how.claim, how.confidence)
    which: dict[str, Any] = {"exactly": exactly, "claim": claim, "trainings": how.trainings}
    lines = lines_of(policies, scenarios, given, how.seed, count, progress, **which)
    more: dict[str, Any] = {"may_begin": until(how.budget_minutes), "progress": progress}
    rows = measure(lines, store, how.where, recordings=recordings, episodes=episodes, **more)
    return kind(rows=rows, axes=tuple(lines[0].options), seed=how.seed)


def _store(folder: Path | None) -> EpisodeStore:
    return EpisodeStore(None if folder is None else folder / "results")


def _written(table: Report, folder: Path | None) -> Report:
    """Return a table, of which a folder has all files."""
    if folder is not None:
        for suffix in SUFFIXES:
            table.write(folder / f"study{suffix}")
        table.write_episodes(folder / "episodes.parquet")
    return table


def _by_name(policies: Any) -> dict[str, Any]:
    """Return policies by name; refuse two of one name."""
    if isinstance(policies, Mapping):
        names, several = [str(name) for name in policies], list(policies.values())
    else:
        several = policies if isinstance(policies, list | tuple) else [policies]
        names = [name_of(policy) for policy in several]
    by_name = dict(zip(names, several, strict=True))
    if len(by_name) < len(several):
        raise ConfigError(
            f"policies = {', '.join(names)} have equal names; give a dict with a name for each"
        )
    return by_name


def read_study(path: Path) -> dict[str, Any]:
    """Return the arguments of `study` that a TOML file has; refuse options of the command."""
    content = read_toml(path, _FILE)
    if "policies" not in content:
        raise ConfigError(f'{path}: names no policies; add one, such as policies = ["moves"]')
    for name in _OF_COMMAND:
        if name in content:
            option = name.replace("_", "-")
            raise ConfigError(f"{path}: {name} is an option of the command; pass --{option} there")
    return content


@showing
def evaluate(
    policy: Any,
    scenario: str | Path | Scenario | None = None,
    *,
    starts: int | None = None,
    progress: Progress | None = automatic,
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
        starts: how many to sample without replacement, by default 50. With a claim by default all,
            and if it is more than there are they begin again, each time with other noise.
        progress: see `study`.
        options: `trainings`, `claim`, `confidence`, `seed`, `world`, `jobs`, `backend`, `out` and
            others of `study`, and those of `minirobots run`, such as `mu`; one value each.

    Returns:
        Rates with their 95 % Wilson intervals, means, `failures`, `results`, which are the episodes
        by index of the start, and `claim`, with its verdict and evidence. Over several `trainings`
        the row has those of each, `by_training`, and their range.

    Raises:
        UserError: see its message.
    """
    if "episodes" in options:
        raise ConfigError("evaluate has no option episodes; give starts, an episode each")
    varying = [name for name, value in options.items() if isinstance(value, list | np.ndarray)]
    if varying or isinstance(policy, list | Mapping) or isinstance(scenario, list | tuple):
        raise ConfigError("evaluate takes one value of each option; study takes several")
    wanted = validate_argument("starts", starts, Count | None)
    how, given = record_of(Sampling, options)
    count = wanted or (None if how.claim else STARTS)
    by_name, exactly = {name_of(policy): policy}, wanted is not None
    work: Any = {"store": _store(how.out), "progress": progress or silent, "exactly": exactly}
    return _written(measured(by_name, [scenario], how, given, count, **work), how.out).rows[0]

"""A study of one's own: policies, scenarios, worlds and options of the co-simulation as axes.

`study` and `evaluate` are names of `minirobots`, too; docs/studies.md shows them.
"""

import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from matplotlib.figure import Figure

from agent.evaluation.claims import JudgedClaim, claim_of
from agent.mdp.exact import joint_starts
from agent.study.episodes import (
    MEASURES,
    OUTCOMES,
    SCENARIO,
    EpisodesRow,
    StudyLine,
    case_of,
    simulate,
)
from agent.study.plot import QUANTITIES, draw_map, draw_measure
from agent.study.policies import name_of, policy_of
from agent.study.store import EpisodeStore
from cosim.base.arguments import (
    ConfigError,
    require_one_of,
    to_plain,
    validate_argument,
    validate_seed,
)
from cosim.base.errors import UserError
from cosim.base.jobs import Backend, Workers, until
from cosim.base.progress import Progress, automatic, showing, silent
from cosim.base.reading import Kind, read_toml
from cosim.base.storage import replacing, write_json, write_whole
from cosim.base.table import Column, Columns, arrow_of, field, markdown, write_parquet
from cosim.base.table import show as show_table
from cosim.model.preset import PAPER
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_in_world
from cosim.model.world import World
from cosim.simulation.options import Physics, options_of
from cosim.simulation.result import EpisodeResult

_LOGGER = logging.getLogger(__name__)
_FILE = Kind("study", "see docs/studies.md")
_OF_COMMAND = ("jobs", "backend", "address", "budget_minutes", "progress")
WRITTEN = (".json", ".md", ".parquet", ".png")


class StudyRow(EpisodesRow, frozen=True, kw_only=True):
    """A row of a study.

    Attributes:
        policy: its name.
        options: values of the axes, by name.
        results: its episodes, by index of the start.
        claim: with its verdict and evidence, if there is one.
    """

    policy: str
    options: dict[str, Any]
    results: dict[int, EpisodeResult]
    claim: JudgedClaim | None = None

    def __repr__(self) -> str:
        """Return what an interactive session shows: the row's table, and not its episodes."""
        return StudyTable((self,), tuple(self.options), 0).to_markdown()

    def labels(self) -> dict[str, Any]:
        """Return what names the row, values that are no number as text."""
        plain = {
            name: value if isinstance(value, bool | int | float) else _text(value)
            for name, value in self.options.items()
        }
        return {"policy": self.policy, "scenario": self.scenario} | plain

    def record(self) -> dict[str, Any]:
        """Return the row without single episodes: its names and its measurements."""
        row = msgspec.structs.asdict(self)
        for name in ("options", "results", "failures", "claim"):
            del row[name]
        return self.labels() | {name: v for name, v in row.items() if name not in self.options}


@dataclass(frozen=True, repr=False)
class StudyTable:
    """Results of a study.

    Attributes:
        rows: policies in scenarios, with every combination of the axes.
        axes: names of the options that vary.
        seed: of samples of starts and of what episodes draw.
    """

    rows: tuple[StudyRow, ...]
    axes: tuple[str, ...]
    seed: int

    def __repr__(self) -> str:
        """Return what an interactive session shows: the table."""
        return self.to_markdown()

    @property
    def columns(self) -> Columns:
        """Columns of the table as text."""
        axes = [Column(n, lambda row, n=n: _text(row.options[n])) for n in self.axes]
        claims = {row.claim.text for row in self.rows if row.claim}
        verdicts = [Column(text, lambda row: row.claim.verdict) for text in claims]
        return (field("policy"), SCENARIO, *axes, *verdicts, *OUTCOMES, *MEASURES)

    def to_markdown(self) -> str:
        """Return the table as Markdown."""
        return markdown(self.columns, self.rows)

    def show(self) -> None:
        """Print the table, in as many parts as the console is wide for."""
        show_table(self.columns, self.rows, names=2 + len(self.axes))

    def to_arrow(self, *, episodes: bool = False) -> Any:
        """Return a `pyarrow.Table`: a row for each row, or for each episode."""
        return arrow_of(self._episodes() if episodes else [row.record() for row in self.rows])

    def to_pandas(self, *, episodes: bool = False) -> Any:
        """Return a `pandas.DataFrame`, see `to_arrow`.

        Raises:
            UserError: pandas is not installed.
        """
        try:
            return self.to_arrow(episodes=episodes).to_pandas()
        except ImportError as error:
            raise UserError(
                "pandas is not installed; run `pip install pandas`, or take to_arrow()"
            ) from error

    def plot(self, axis: str | None = None, quantity: str = "success") -> Figure:
        """Draw a quantity over one axis, a panel for each scenario, or as a map over two axes.

        Args:
            axis: by default the first one; the scenario where no option varies; both where two do.
            quantity: such as "collision", "path_length_cm" or "energy_j"; bars are its 95 %
                interval, if it has one.

        Raises:
            ConfigError: no such option varies, or there is no such quantity.
        """
        require_one_of("quantity", quantity, QUANTITIES)
        label = QUANTITIES[quantity][0]
        if axis is None and len(self.axes) == 2:
            across, up = self.axes
            panels = self._panels(lambda row: f"{row.policy}, scenario {row.scenario}")
            title = f"{label} over {across} and {up}"
            return draw_map(panels, StudyRow.labels, (across, up), quantity=quantity, title=title)
        chosen = axis or (self.axes[0] if self.axes else "scenario")
        if chosen not in {*self.axes, "scenario"}:
            known = ", ".join(self.axes) or "nothing"
            raise ConfigError(f"axis = {chosen!r} does not vary; in this study {known} does")

        def series(row: StudyRow) -> str:
            others = [f"{n} {_text(row.options[n])}" for n in self.axes if n != chosen]
            return ", ".join([row.policy, *others])

        whole = chosen == "scenario"
        panels = self._panels(lambda row: "all scenarios" if whole else f"scenario {row.scenario}")
        bars = "; bars: 95 % intervals" if f"{quantity}_low" in StudyRow.__struct_fields__ else ""
        return draw_measure(
            panels,
            lambda row: row.labels()[chosen],
            series,
            quantity=quantity,
            axis=chosen,
            title=f"{label} over {chosen}{bars}",
        )

    def _panels(self, name: Callable[[StudyRow], str]) -> dict[str, list[StudyRow]]:
        panels: dict[str, list[StudyRow]] = {}
        for row in self.rows:
            panels.setdefault(name(row), []).append(row)
        return panels

    def write(self, path: str | Path, quantity: str = "success") -> None:
        """Write the table as Parquet, JSON or Markdown, or its plot as PNG, by the suffix.

        Args:
            path: file to write.
            quantity: that the plot shows, see `plot`.

        Raises:
            ConfigError: the suffix is another one, or there is no such quantity.
        """
        path = Path(validate_argument("path", path, Path))
        match path.suffix:
            case ".json":
                rows = [
                    row.record() | {"failures": row.failures, "claim": row.claim}
                    for row in self.rows
                ]
                write_json(path, {"seed": self.seed, "axes": self.axes, "rows": rows})
            case ".md":
                write_whole(path, self.to_markdown() + "\n")
            case ".parquet":
                write_parquet(path, [row.record() for row in self.rows])
            case ".png":
                with replacing(path) as temporary:
                    self.plot(quantity=quantity).savefig(temporary, format="png", dpi=150)
            case _:
                raise ConfigError(f"{path}: its name must end in one of {', '.join(WRITTEN)}")

    def write_episodes(self, path: str | Path) -> None:
        """Write all episodes to a Parquet file, a row each."""
        write_parquet(Path(path), self._episodes())

    def _episodes(self) -> list[dict[str, Any]]:
        return [
            row.labels() | {"digest": row.digest, "index": index} | msgspec.structs.asdict(result)
            for row in self.rows
            for index, result in row.results.items()
        ]


@showing
def study(
    policies: Any,
    scenario: Any = None,
    *,
    episodes: int = 50,
    claim: str | None = None,
    confidence: float | None = None,
    seed: int = 0,
    world: Any = None,
    out: str | Path | None = None,
    jobs: int = -1,
    backend: Backend = "threads",
    address: str | None = None,
    budget_minutes: float | None = None,
    progress: Progress | None = automatic,
    **options: Any,
) -> StudyTable:
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
            starts where there are fewer, or with a claim these again, each time with other noise.
        claim: "RATE < p" or "RATE > p" about every row, with the rate of collision, out_of_board,
            timeout, failure or success. A row ends with the episode that certifies or refuses it.
        confidence: least probability that a verdict is right, by default 0.999.
        seed: of training, of the sample of starts and of what episodes draw.
        world: world file, record or dict of its fields, or a list of them.
        out: folder of the rows, from which the same study resumes, and of the tables study.json,
            .md, .parquet and episodes.parquet; by default nothing is kept.
        jobs: episodes that run at the same time, -1 for one per core.
        backend: threads, loky, dask or ray; the results do not depend on it.
        address: of a Dask or Ray cluster.
        budget_minutes: after which no episode is started.
        progress: receives what is trained and simulated; by default it is shown on stderr if the
            call takes more than two seconds. None shows nothing.
        options: of `minirobots run`, such as `mu`, `noise`, `speed`, `shield`; a list or an array
            is an axis.

    Returns:
        The table.

    Raises:
        UserError: see its message.
    """
    report, judged = progress or silent, claim_of(claim, confidence)
    where = Workers(jobs=jobs, backend=backend, address=address)
    named = _named(policies)
    scenario = to_plain("scenario", scenario)
    scenarios = scenario if isinstance(scenario, list | tuple) else [scenario]
    folder: Path | None = validate_argument("out", out, Path | None)
    given = {name: to_plain(name, value) for name, value in {"world": world, **options}.items()}
    axes = {name: value for name, value in given.items() if isinstance(value, list)}
    if not (named and scenarios and all(axes.values())):
        raise ConfigError("policies, scenarios and every axis need at least one value each")
    fixed = {name: value for name, value in given.items() if name not in axes}
    episodes, seed = validate_argument("episodes", episodes, int), validate_seed(seed)
    if episodes < 1:
        raise ConfigError(f"episodes = {episodes} must be at least 1")
    lines: list[StudyLine] = []
    found: dict[tuple[str, Scenario | None], Any] = {}
    for board, (name, policy), values in product(scenarios, named.items(), product(*axes.values())):
        chosen = dict(zip(axes, values, strict=True))
        physics = fixed | chosen
        declared = physics.pop("world")
        setup = options_of("study", physics)
        only = None if board is None else setup.board(find_in_world(board, declared)[0])
        acting = found.get((name, only)) or policy_of(policy, only, seed=seed, progress=report)
        found[name, only] = acting
        case = case_of(acting, setup, seed, board, world=declared, name=name, progress=report)
        available = len(case.starts)
        indices = case.rounds(episodes) if judged else case.sample(min(episodes, available))
        labels = {"policy": name, "options": chosen, "results": {}}
        lines.append(StudyLine(case, indices, labels, judged))
    unrecognizable = [
        name for (name, _), policy in found.items() if not getattr(policy, "recognizable", True)
    ]
    if folder is not None and unrecognizable:
        _LOGGER.warning(
            "%s: its source is in no file or it cannot be pickled; the study's episodes are kept "
            "in memory only and will not be found again",
            ", ".join(dict.fromkeys(unrecognizable)),
        )
    store = EpisodeStore(None if folder is None or unrecognizable else folder / "results")
    simulate(lines, store, where, may_begin=until(budget_minutes), progress=report)
    rows = tuple(
        msgspec.structs.replace(line.row(store, StudyRow), results=line.results(store))
        for line in lines
    )
    table = StudyTable(rows, tuple(axes), seed)
    if folder is not None:
        for suffix in WRITTEN:
            table.write(folder / f"study{suffix}")
        table.write_episodes(folder / "episodes.parquet")
    return table


def _named(policies: Any) -> dict[str, Any]:
    """Policies by name.

    Raises:
        ConfigError: two have one name.
    """
    if isinstance(policies, Mapping):
        return {str(name): policy for name, policy in policies.items()}
    several = policies if isinstance(policies, list | tuple) else [policies]
    names = [name_of(policy) for policy in several]
    if len(set(names)) < len(names):
        raise ConfigError(
            f"policies = {', '.join(names)} have equal names; give a dict with a name for each"
        )
    return dict(zip(names, several, strict=True))


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, World):
        value = {
            name: part
            for name, part in msgspec.to_builtins(value).items()
            if part != msgspec.to_builtins(getattr(World(), name))
        }
    if isinstance(value, Mapping):
        return ", ".join(f"{name} = {_text(part)}" for name, part in value.items()) or "ideal"
    if isinstance(value, Scenario):
        return value.name
    if isinstance(value, Iterable) and not isinstance(value, str):
        return " ".join(map(_text, value))
    return "none" if value is None else str(value)


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
    confidence: float | None = None,
    progress: Progress | None = automatic,
    **options: Any,
) -> StudyRow:
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
        claim, confidence: see `study`.
        progress: see `study`.
        options: `seed`, `world`, `jobs`, `backend`, `out` and others of `study`, and those of
            `minirobots run`, such as `mu`; one value each.

    Returns:
        Rates with their 95 % Wilson intervals, means, `failures`, `results`, which are the episodes
        by index of the start, and `claim`, with its verdict and evidence.

    Raises:
        UserError: see its message.
    """
    if starts is not None and validate_argument("starts", starts, int) < 1:
        raise ConfigError(f"starts = {starts} must be at least 1")
    if "episodes" in options:
        raise ConfigError("evaluate has no option episodes; give starts, an episode each")
    varying = [name for name, value in options.items() if isinstance(value, list | np.ndarray)]
    if varying or isinstance(policy, list | Mapping) or isinstance(scenario, list | tuple):
        raise ConfigError("evaluate takes one value of each option; study takes several")
    only = None if scenario is None else find_in_world(scenario, options.get("world"))[0]
    if only is not None:
        only = Physics(preset=options.get("preset", PAPER)).board(only)
    found = policy_of(policy, only, seed=options.get("seed", 0), progress=progress or silent)
    available = len(joint_starts(found.process))
    if starts is None:
        starts = available if claim is not None else min(20, available)
    elif claim is None and starts > available:
        name = found.config.scenario.name
        raise ConfigError(f"starts = {starts}: scenario {name} has only {available}; ask for less")
    options |= {"claim": claim, "confidence": confidence, "progress": progress}
    table = study({name_of(policy): policy}, scenario, episodes=starts, **options)
    (row,) = table.rows
    return row


__all__ = ["StudyRow", "StudyTable", "evaluate", "read_study", "study"]

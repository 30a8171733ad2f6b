"""Rows of tables of policies: what each achieves, in the dynamics or on the grid, and columns."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from agent.evaluation.cases import Case
from agent.evaluation.claims import JudgedClaim
from agent.evaluation.statistics import (
    Interval,
    Statistics,
    interval_text,
    rate,
    rate_over_trainings,
    summarise,
)
from agent.mdp.greedy import GreedyPolicy
from cosim.base.table import Column, Columns, field, markdown
from cosim.model.outcome import ENDS, SUCCESS, Outcome
from cosim.model.scenario import Cell, Scenario
from cosim.model.world import World
from cosim.simulation.result import EpisodeResult


class Failure(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A start that did not end in success; in the dynamics with its index and its recording."""

    starts: tuple[Cell, ...]
    outcome: Outcome
    index: int | None = None
    recording: str | None = None


class Row(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What a policy achieves in a scenario; None where there is no such number.

    Every outcome has the share of the episodes that ended so, and its 95 % interval: Wilson's, or
    `rate_over_trainings` where the row is over several. On the grid only success from a sample of
    the starts has one, as all else is exact. In the dynamics path, rotation, time, energy and moves
    are means over successful episodes, path, rotation and moves also over the robots, the energy
    summed over them.
    """

    policy: str  # its name, file or method
    scenario: str
    options: dict[str, Any] = {}  # values of the axes of a study, by name
    episodes: int
    success: float | None = None
    success_low: float | None = None
    success_high: float | None = None
    success_least: float | None = None  # of a training, and the most
    success_most: float | None = None
    collision: float | None = None
    collision_low: float | None = None
    collision_high: float | None = None
    out_of_board: float | None = None
    out_of_board_low: float | None = None
    out_of_board_high: float | None = None
    timeout: float | None = None
    timeout_low: float | None = None
    timeout_high: float | None = None
    path_length_cm: float | None = None
    rotation_deg: float | None = None
    # Mean over the episodes that succeed here and on the grid of the path over that of the policy's
    # exact grid episode from the same start, with its Student interval
    path_ratio_to_grid: float | None = None
    path_ratio_to_grid_low: float | None = None
    path_ratio_to_grid_high: float | None = None
    min_distance_cm: float | None = None  # of two robots' centres in any episode
    sim_time_s: float | None = None
    energy_j: float | None = None
    steps: float | None = None  # moves
    ratio_to_bound: float | None = None  # path over the exact optimum, `agent.mdp.optimum.ratios`
    steps_ratio_to_bound: float | None = None
    mu: float | None = None
    shield: bool | None = None
    drive_speed_m_s: float | None = None  # of the calibration
    starts: int  # combinations of start cells that the scenario has; on the grid those evaluated
    planned: int  # episodes asked for
    wall_s: float | None = None  # of the episodes, of all threads together
    digest: str = ""  # of the case, if it is one
    training: int | None = None  # its seed, of a policy that the study has trained
    trainings: int | None = None  # that the row is over, None if nothing was learnt
    by_training: tuple["Row", ...] = ()  # rows of single trainings, if they are several
    failing_starts: int  # episodes that did not end in success
    failures: tuple[Failure, ...] = ()  # these; on the grid at most the first 1000
    recordings: tuple[str, ...] = ()
    claim: JudgedClaim | None = None
    results: dict[int, EpisodeResult] = {}  # by index of the start

    def __repr__(self) -> str:
        """Return what an interactive session shows: the row's table, and not its episodes."""
        return markdown(columns_of([self], list(self.options)), [self])

    def interval(self, name: str) -> Interval:
        """Return a measure with its interval."""
        return Interval(*(getattr(self, name + end) for end in ("", "_low", "_high")))

    def labels(self) -> dict[str, Any]:
        """Return what names the row, values that are no number as text."""
        plain = {
            name: value if isinstance(value, bool | int | float) else text_of(value)
            for name, value in self.options.items()
        }
        return {"policy": self.policy, "scenario": self.scenario} | plain

    def record(self) -> dict[str, Any]:
        """Return the row without single episodes: its names, and its numbers in the dynamics."""
        without = {*_ROW_ONLY, *self.options}
        numbers = {k: v for k, v in msgspec.structs.asdict(self).items() if k not in without}
        return self.labels() | numbers


_ROW_ONLY = (
    *("options", "results", "failures", "recordings", "claim", "by_training"),
    *("steps", "ratio_to_bound", "steps_ratio_to_bound"),
)


def measures(parts: Sequence[tuple[Case, Mapping[int, EpisodeResult]]]) -> dict[str, Any]:
    """Return the fields of a `Row` that are statistics over episodes.

    Args:
        parts: the case of each training, or the only one, and its episodes by index of the start;
            of several all have the same.
    """
    results = [result for _, episodes in parts for result in episodes.values()]
    found: dict[str, Any] = {"episodes": len(results)}
    for outcome in ENDS:
        hits = np.array([[r.outcome == outcome for r in of.values()] for _, of in parts], bool)
        several = len(parts) > 1 and hits.size > 0
        over = rate_over_trainings(hits) if several else rate(int(hits.sum()), hits.size)
        found |= _with_ends(str(outcome), over)
        if several and outcome == Outcome.SUCCESS:
            shares = hits.mean(axis=1)
            found |= {"success_least": float(shares.min()), "success_most": float(shares.max())}
    for name in ("path_length_cm", "rotation_deg", "sim_time_s", "energy_j"):
        values = [getattr(r, name) for r in results if r.outcome == Outcome.SUCCESS]
        found[name] = float(np.mean(values)) if values else None
    ratios = [_ratios_to_grid(*part) for part in parts]
    if len(ratios) > 1:  # what varies is the training
        ratios = [np.array([of[np.isfinite(of)].mean() for of in ratios if np.isfinite(of).any()])]
    found |= _with_ends("path_ratio_to_grid", summarise(ratios[0], 0.0))
    distances = [r.min_distance_cm for r in results if r.min_distance_cm is not None]
    return found | {"min_distance_cm": min(distances, default=None)}


def _with_ends(name: str, of: Interval | Statistics) -> dict[str, float | None]:
    return {name: of.mean, f"{name}_low": of.low, f"{name}_high": of.high}


def _ratios_to_grid(case: Case, results: Mapping[int, EpisodeResult]) -> np.ndarray:
    """(successes,) float64, NaN where the policy fails on the grid."""
    successes = {index: r for index, r in results.items() if r.outcome == Outcome.SUCCESS}
    if not successes:
        return np.empty(0)
    policy = case.policy
    if not isinstance(policy, GreedyPolicy):
        return np.full(len(successes), np.nan)
    grid = policy.evaluate_on_grid(case.starts[[index % len(case.starts) for index in successes]])
    cell_cm = 100.0 * policy.config.scenario.cell_m
    expected = cell_cm * grid.path_cells.mean(axis=1)
    expected[grid.outcome != SUCCESS] = np.nan
    return np.array([r.path_length_cm for r in successes.values()]) / expected


def interval_column(name: str, *form: Any, heading: str | None = None) -> Column:
    """Return the column of a measure with its interval; `form` is that of `interval_text`."""
    text = heading or name.replace("_", " ")
    return Column(text, lambda row: interval_text(row.interval(name), *form))


def rate_column(name: str) -> Column:
    """Return the column of the rate of an outcome."""
    return interval_column(name, 1, 100.0, "%")


def _episodes(row: Row) -> str:
    n = row.episodes
    return str(n) if n == row.planned else f"{n} of {row.planned}"


def _others(row: Row) -> str:
    counts = [round(row.episodes * (share or 0.0)) for share in (row.out_of_board, row.timeout)]
    return ", ".join(map(str, counts)) if row.episodes else "–"


def _failures(row: Row) -> str:
    counts = {str(end): round(row.episodes * (getattr(row, end) or 0.0)) for end in ENDS[1:]}
    return ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in counts.items() if n) or "–"


def _of_trainings(row: Row) -> str:
    if row.success_least is None or row.success_most is None:
        return str(row.trainings or "–")
    ends = f"{100.0 * row.success_least:.0f} to {100.0 * row.success_most:.0f} %"
    return f"{row.trainings}: {ends}"


POLICY, SCENARIO, METHOD = field("policy"), field("scenario"), field("policy", heading="method")
MU = field("mu", "{:g}", "µ")
SHIELD = Column("shield", lambda row: "on" if row.shield else "off")
PATH_RATIO = interval_column("path_ratio_to_grid", 3, heading="× own grid path")
TRAININGS = Column("trainings", _of_trainings)
OUTCOMES = (
    TRAININGS,
    Column("episodes", _episodes),
    rate_column("success"),
    rate_column("collision"),
    Column("out of board, timeout", _others),
)
MEASURES = (
    field("min_distance_cm", "{:.2f} cm", "min distance"),
    field("path_length_cm", "{:.1f} cm", "path"),
    field("rotation_deg", "{:.0f}°", "rotation"),
    field("sim_time_s", "{:.0f} s", "simulated"),
    field("energy_j", "{:.1f} J", "energy"),
)


def option_column(name: str, heading: str | None = None) -> Column:
    """Return the column of an axis."""
    return Column(heading or name, lambda row: text_of(row.options[name]))


OF_POLICIES = (
    POLICY,
    SCENARIO,
    TRAININGS,
    Column("episodes", lambda r: f"{r.episodes}" if r.claim else f"{r.episodes} of {r.starts}"),
    *map(rate_column, ENDS),
    *MEASURES[1:3],
    PATH_RATIO,
    MEASURES[0],
    *MEASURES[3:],
)


# What a console shows that is not wide enough for all.
_BRIEF = (*OUTCOMES[:3], Column("failures", _failures), MEASURES[1], MEASURES[3])


def columns_of(rows: Iterable[Row], axes: Iterable[str], *, brief: bool = False) -> Columns:
    """Return the columns of a study with these axes; a claim of its rows has one, too."""
    claims = dict.fromkeys(row.claim.text for row in rows if row.claim)
    verdicts = [Column(text, lambda row: row.claim.verdict) for text in claims]
    measured = _BRIEF if brief else (*OUTCOMES, *MEASURES)
    return (POLICY, SCENARIO, *map(option_column, axes), *verdicts, *measured)


def text_of(value: Any) -> str:
    """Return the value of an axis as text; of a world what is not ideal in it."""
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, World):
        ideal = msgspec.to_builtins(World())
        value = {k: v for k, v in msgspec.to_builtins(value).items() if v != ideal[k]}
    if isinstance(value, Mapping):
        return ", ".join(f"{name} = {text_of(part)}" for name, part in value.items()) or "ideal"
    if isinstance(value, Scenario):
        return value.name
    if isinstance(value, Iterable) and not isinstance(value, str):
        return " ".join(map(text_of, value))
    return "none" if value is None else str(value)

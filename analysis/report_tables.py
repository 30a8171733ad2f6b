"""Result files as tables of text: learning, transfer to the co-simulation, episodes, timings.

Reads what commands wrote and formats it, with intervals; the page around it is `analysis.report`.
"""

import json
from pathlib import Path
from typing import Any, NamedTuple

from analysis.results import RESULTS
from cosim.config import CoSimConfig
from cosim.errors import UserError

NOTHING = "–"
_OUTCOMES = ("success", "collision", "out_of_board", "timeout")
TIMINGS_FILE = "timings.json"
# Column, measure of `agent.evaluation`, factor, digits, unit.
_MEASURES = (
    ("success", "success", 100.0, 1, " %"),
    ("path length, cm", "path_length_cm", 1.0, 2, ""),
    ("moves", "steps", 1.0, 2, ""),
    ("path over shortest", "ratio_to_bound", 1.0, 3, ""),
)


class ReportError(UserError):
    """Results that no report can be made from."""


class Table(NamedTuple):
    """A table as it is shown.

    Attributes:
        title: what it shows.
        note: how to read it.
        command: that made its numbers; empty if none did alone.
        header: of the columns.
        rows: of text, as long as the header.
    """

    title: str
    note: str
    command: str
    header: tuple[str, ...]
    rows: list[tuple[str, ...]]


def read_json(path: Path) -> Any:
    """Content of a result file; None if there is none.

    Raises:
        ReportError: it is damaged.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except ValueError as error:
        raise ReportError(f"{path}: damaged ({error}); make it again") from error


def learning_tables(results: Path) -> list[Table]:
    """What training found, a table per experiment of the paper."""
    titles = {
        "fig08": "One robot, greedy policies after training",
        "fig11": "Two robots, greedy policies after training",
        "fig10": "The coefficient c of Eq. (12), scenario 4",
    }
    tables = []
    for name, title in titles.items():
        content = read_json(RESULTS[name].proof_in(results))
        if content is not None:
            tables.append(_learning_table(title, content))
    return tables


def _learning_table(title: str, content: dict[str, Any]) -> Table:
    rows, differences = [], content.get("differences", {})
    for key, variant in content["variants"].items():
        row = [variant["label"]]
        for _, measure, factor, digits, unit in _MEASURES:
            row.append(interval(variant["over_runs"][measure], factor, digits, unit))
        if differences:
            difference = differences.get(key)
            row.append(interval(difference["path_length_cm"]) if difference else NOTHING)
        rows.append(tuple(row))
    header = ["", *(column for column, *_ in _MEASURES)]
    if differences:
        header.append("difference in cm, same seeds")
    runs = len(next(iter(content["variants"].values()))["runs"])
    note = (
        f"Every start, evaluated exactly, for each of {_runs(runs)} of {content['episodes']:,} "
        "training episodes: mean and 95 % bootstrap interval over the runs."
    )
    command = (
        f"python -m agent.experiments {content['experiment']} --runs {runs} "
        f"--episodes {content['episodes']} --seed {content['seed']}"
    )
    return Table(title, note, command, tuple(header), rows)


def _runs(count: int) -> str:
    return "1 run" if count == 1 else f"{count} runs"


def interval(
    statistics: dict[str, Any], factor: float = 1.0, digits: int = 2, unit: str = ""
) -> str:
    """Mean and 95 % interval of `agent.statistics`, or of any record with mean, low and high."""
    mean, low, high = (statistics.get(name) for name in ("mean", "low", "high"))
    if mean is None:
        return NOTHING
    text = f"{factor * mean:.{digits}f}{unit}"
    if low is not None and high is not None:
        text += f" [{factor * low:.{digits}f}, {factor * high:.{digits}f}]"
    return text.replace("-", "−")


def transfer_tables(results: Path) -> list[Table]:
    """What policies achieve in co-simulation, by training method; none if it was not evaluated.

    Raises:
        ReportError: the file is damaged.
    """
    content = read_json(RESULTS["transfer"].proof_in(results))
    if content is None:
        return []
    try:
        rows = [_transfer_row(row) for row in content["rows"]]
    except (KeyError, TypeError) as error:
        path = RESULTS["transfer"].proof_in(results)
        raise ReportError(f"{path}: lacks {error}; make it again") from error
    outcomes = (name.replace("_", " ") for name in _OUTCOMES)
    header = ("scenario", "training", "µ", "safety layer", "episodes", *outcomes, "path over grid")
    note = (
        "Policies in the full dynamics with noise on the measured speeds; shares with 95 % Wilson "
        "intervals."
    )
    title = "Success in co-simulation by training method"
    return [Table(title, note, "python -m cosim.transfer", header, rows)]


def _transfer_row(row: dict[str, Any]) -> tuple[str, ...]:
    shares = (_named(row, name, 100.0, 1, " %") for name in _OUTCOMES)
    margin_m = row.get("safety_margin_m") or 0.0
    return (
        str(row["scenario"]),
        str(row["method"]),
        f"{row['mu']:g}",
        f"{1e3 * margin_m:g} mm" if margin_m else NOTHING,
        str(row["episodes"]),
        *shares,
        _named(row, "path_ratio_to_grid", 1.0, 3, ""),
    )


def _named(row: dict[str, Any], name: str, factor: float, digits: int, unit: str) -> str:
    """A value of a row of `cosim.transfer` with its interval."""
    statistics = {"mean": row[name], "low": row[f"{name}_low"], "high": row[f"{name}_high"]}
    return interval(statistics, factor, digits, unit)


def read_timings(results: Path) -> dict[str, Any] | None:
    """What `analysis.reproduce` wrote of its stages; None if it did not make these results.

    Raises:
        ReportError: the file is damaged.
    """
    return read_json(results / TIMINGS_FILE)


def timing_table(timings: dict[str, Any]) -> Table:
    """How long each stage of `analysis.reproduce` took."""
    rows = [
        (
            name,
            f"{stage['seconds']:.1f} s",
            str(stage["attempts"]),
            "" if stage["finished"] else "not finished",
        )
        for name, stage in timings["stages"].items()
    ]
    total = sum(stage["seconds"] for stage in timings["stages"].values())
    note = (
        f"Wall-clock time on {timings['cores']} cores, profile “{timings['profile']['name']}”; "
        "a stage that was interrupted and continued counts with all its attempts."
    )
    rows.append(("all", f"{total:.1f} s", "", ""))
    header = ("stage", "time", "attempts", "")
    return Table("Time", note, "python -m analysis.reproduce", header, rows)


def parameter_table() -> Table:
    """Parameters of the co-simulation as `cosim.params` has them."""
    rows = []
    for name, row in CoSimConfig().table().items():
        value = f"{row['value']:.6g}" if isinstance(row["value"], float) else str(row["value"])
        rows.append((name, f"{value} {row['unit']}".strip(), row["description"], row["source"]))
    header = ("name", "value", "meaning", "source")
    return Table("Parameters", "SI units.", "cosim/params.py", header, rows)

"""Result files as tables of text: learning, transfer to the co-simulation, episodes, times.

Reads what commands wrote and formats it, with intervals; the page around it is `analysis.report`.
"""

from pathlib import Path
from typing import NamedTuple

from agent.evaluation.statistics import interval_text
from agent.experiments.results import ExperimentResult
from agent.study.episodes import METHOD, MU, PATH_RATIO, SCENARIO, SHIELD, rate_column
from agent.study.transfer import QUICK_EPISODES
from analysis.figures.style import NOTHING
from analysis.reading.results import DRIVEN_BY, RESULTS, episodes_of
from analysis.reading.written import read_experiment, read_run, read_transfer
from analysis.timings import TimingsFile
from cosim.base.table import field
from cosim.model.built_in import PAPER
from cosim.model.config import CoSimConfig
from cosim.model.outcome import ENDS

# Column, measure of `agent.mdp.exact`, digits, factor, unit.
_MEASURES = (
    ("success", "success", 1, 100.0, " %"),
    ("path length, cm", "path_length_cm", 2, 1.0, ""),
    ("moves", "steps", 2, 1.0, ""),
    ("path over shortest", "ratio_to_bound", 3, 1.0, ""),
)
_TRANSFER = (SCENARIO, METHOD, MU, SHIELD, field("episodes"), *map(rate_column, ENDS), PATH_RATIO)


class ReportTable(NamedTuple):
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


def learning_tables(results: Path) -> list[ReportTable]:
    """Return the results of training, a table per experiment of the paper.

    Raises:
        UserError: a file is damaged.
    """
    titles = {
        "fig08": "One robot, greedy policies after training",
        "fig11": "Two robots, greedy policies after training",
        "fig10": "The coefficient c of Eq. (12), scenario 4",
        "sequel": "Four and six robots, Q-learning and double Q-learning",
    }
    tables = []
    for name, title in titles.items():
        if RESULTS[name].exists(results):
            tables.append(_learning_table(title, read_experiment(name, results)))
    return tables


def _learning_table(title: str, content: ExperimentResult) -> ReportTable:
    rows, differences = [], content.differences
    for key, variant in content.variants.items():
        row = [variant.label]
        for _, measure, digits, factor, unit in _MEASURES:
            row.append(interval_text(variant.over_runs[measure], digits, factor, unit))
        if differences:
            difference = differences.get(key)
            row.append(interval_text(difference["path_length_cm"]) if difference else NOTHING)
        rows.append(tuple(row))
    header = ["", *(column for column, *_ in _MEASURES)]
    if differences:
        header.append("difference in cm, same seeds")
    runs = len(next(iter(content.variants.values())).runs)
    note = (
        f"Every start, or 10 000 draws where there are more, for each of {runs} "
        f"run{'s' * (runs > 1)} of {content.episodes:,} training episodes: mean over the runs and "
        "its 95 % Student interval, which is [–] where there are too few runs, or too many agree."
    )
    command = (
        f"minirobots experiments {content.experiment} --runs {runs} "
        f"--episodes {content.episodes} --seed {content.seed}"
    )
    return ReportTable(title, note, command, tuple(header), rows)


def transfer_tables(results: Path) -> list[ReportTable]:
    """Return the table of success in co-simulation, by method; none if it was not evaluated.

    Raises:
        UserError: the file is damaged.
    """
    if not RESULTS["transfer"].exists(results):
        return []
    report = read_transfer(results)
    rows = [tuple(column.text(row) for column in _TRANSFER) for row in report.rows]
    command = f"minirobots transfer --seed {report.seed}"
    for of in ("scenario", "method"):
        command += f" --{of}s " + " ".join(dict.fromkeys(getattr(row, of) for row in report.rows))
    if max((row.planned for row in report.rows), default=0) <= QUICK_EPISODES:
        command += " --quick"
    header = tuple(column.heading for column in _TRANSFER)
    note = (
        "Policies in the full dynamics with noise on the measured speeds; shares with 95 % Wilson "
        "intervals."
    )
    title = "Success in co-simulation by training method"
    return [ReportTable(title, note, command, header, rows)]


def episode_table(results: Path) -> list[ReportTable]:
    """Return the table of recorded episodes; none if no episode has been recorded.

    Raises:
        UserError: a summary is damaged.
    """
    rows = []
    for scenario in PAPER:
        for method in DRIVEN_BY:
            result = RESULTS[episodes_of(scenario, method)]
            for number, episode in enumerate(read_run(result.name, results)):
                recording = f"{result.path}/{episode.recording}" if episode.recording else NOTHING
                outcome = episode.outcome.replace("_", " ")
                lasted = f"{episode.sim_time_s:.0f} s"
                path = f"{episode.path_length_cm:.1f} cm"
                name = f"{scenario}-{method}/{number}"
                rows.append((name, outcome, path, lasted, recording))
    if not rows:
        return []
    note = (
        "Scenario, method and number of the episode, with noise on the motors’ measured speeds. "
        "A recording in the folder of results opens with"
    )
    header = ("episode", "outcome", "path length", "lasted", "recording")
    return [ReportTable("Episodes", note, "rerun FILE.rrd", header, rows)]


def timing_table(timings: TimingsFile) -> ReportTable:
    """Return the table of the times of a reproduction's stages."""
    rows = [
        (
            name,
            f"{stage.seconds:.1f} s",
            str(stage.attempts),
            "" if stage.finished else "not finished",
        )
        for name, stage in timings.stages.items()
    ]
    total = sum(stage.seconds for stage in timings.stages.values())
    note = (
        f"Wall-clock time on {timings.cores} cores, profile “{timings.profile['name']}”; "
        "a stage that was interrupted and continued counts with all its attempts."
    )
    rows.append(("all", f"{total:.1f} s", "", ""))
    header = ("stage", "time", "attempts", "")
    return ReportTable("Time", note, "minirobots reproduce", header, rows)


def parameter_table() -> ReportTable:
    """Parameters of the co-simulation as `cosim.model.params` has them."""
    rows = []
    for name, row in CoSimConfig().table().items():
        value = f"{row['value']:.6g}" if isinstance(row["value"], float) else str(row["value"])
        rows.append((name, f"{value} {row['unit']}".strip(), row["description"], row["source"]))
    header = ("name", "value", "meaning", "source")
    return ReportTable("Parameters", "SI units.", "cosim/model/params.py", header, rows)

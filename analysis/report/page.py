"""The report: one page that shows what there is, from result files only.

The page stands in a folder with its figures and opens from disk.
"""

import shutil
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import jinja2

from agent.evaluation.rows import METHOD, MU, PATH_RATIO, SCENARIO, SHIELD, TRAININGS, rate_column
from agent.evaluation.run import RunSummary
from agent.evaluation.statistics import interval_text
from agent.experiments.results import ExperimentResult
from agent.study.report import Report
from agent.web.page import write_page
from analysis.figures.style import (
    FORMATS,
    NOTHING,
    UNTESTED,
    Caption,
    Claim,
    figure_entries,
    read_caption,
)
from analysis.profiles import FULL
from analysis.reading.results import (
    DRIVEN_BY,
    RESULTS,
    episodes_of,
    missing,
    read_experiment,
    read_result,
)
from analysis.timings import TimingsFile, read_timings
from cosim.base.errors import FileError, UserError
from cosim.base.provenance import versions
from cosim.base.storage import replacing, write_json, write_whole
from cosim.base.table import field
from cosim.model.config import CoSimConfig
from cosim.model.outcome import ENDS
from cosim.model.params import SPEED_NOISE, TABLE_I, TIMING
from cosim.model.scenario_file import find_scenario

PAGE, CLAIMS, PLAY = "index.html", "claims.json", "play.html"
PLAYED = "4"  # scenario of the page in which the robots drive
# Experiments with a table, and its title.
_EXPERIMENTS = {
    "fig08": "One robot, greedy policies after training",
    "fig11": "Two robots, greedy policies after training",
    "fig10": "The coefficient c of Eq. (12), scenario 4",
    "sequel": "Four and six robots, Q-learning and double Q-learning",
}
# Column, measure of `agent.mdp.exact`, digits, factor, unit.
_MEASURES = (
    ("success", "success", 1, 100.0, " %"),
    ("path length, cm", "path_length_cm", 2, 1.0, ""),
    ("moves", "steps", 2, 1.0, ""),
    ("path over shortest", "ratio_to_bound", 3, 1.0, ""),
)
_TRANSFER = (
    SCENARIO,
    METHOD,
    MU,
    SHIELD,
    TRAININGS,
    field("episodes"),
    *map(rate_column, ENDS),
    PATH_RATIO,
)
# Of what no reproduction measures.
_UNMEASURED = (
    Claim("Sec. V: training takes “about 10 minutes”", "see the table Time on this page", NOTHING),
    Claim("Hardware", "no robot was driven", UNTESTED),
)


class ReportTable(NamedTuple):
    """A table of text as it is shown, and the command that made its numbers."""

    title: str
    note: str
    command: str
    header: tuple[str, ...]
    rows: list[tuple[str, ...]]


def claim_rows(captions: Iterable[Caption], *, brief: bool) -> list[dict[str, Any]]:
    """Return the claims of the paper in its order, each with its figure, "" if it has none."""
    claims = [(caption.figure, claim) for caption in captions for claim in caption.claims]
    rows = [{"figure": figure, "brief": brief} | asdict(claim) for figure, claim in claims]
    return rows + [{"figure": "", "brief": False} | asdict(claim) for claim in _UNMEASURED]


def learning_table(title: str, content: ExperimentResult) -> ReportTable:
    """Return the results of training of an experiment."""
    rows, differences = [], content.differences
    for key, variant in content.variants.items():
        row = [variant.label]
        for _, measure, digits, factor, unit in _MEASURES:
            row.append(interval_text(variant.over_runs[measure], digits, factor, unit))
        if differences:
            difference = differences.get(key)
            row.append(interval_text(difference["path_length_cm"]) if difference else NOTHING)
        rows.append(tuple(row))
    header = ("", *(column for column, *_ in _MEASURES))
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
    more = ("difference in cm, same seeds",) if differences else ()
    return ReportTable(title, note, command, header + more, rows)


def transfer_table(report: Report) -> ReportTable:
    """Return the table of success in co-simulation, by method."""
    return ReportTable(
        "Success in co-simulation by training method",
        "Policies in the full dynamics with noise on the measured speeds; shares with 95 % "
        "intervals over trainings and starts.",
        RESULTS["transfer"].command(Path("results")),
        tuple(column.heading for column in _TRANSFER),
        [tuple(column.text(row) for column in _TRANSFER) for row in report.rows],
    )


def episode_table(results: Path) -> ReportTable:
    """Return the table of recorded episodes, which has no rows if none has been recorded."""
    rows = []
    for result in RESULTS.values():
        if result.maker != "run" or not result.exists(results):
            continue
        summary: RunSummary = read_result(result.name, results, RunSummary)
        for number, episode in enumerate(summary.episodes):
            recording = f"{result.path}/{episode.recording}" if episode.recording else NOTHING
            lasted, path = f"{episode.sim_time_s:.0f} s", f"{episode.path_length_cm:.1f} cm"
            name = f"{result.of}-{result.method}/{number}"
            rows.append((name, episode.outcome.replace("_", " "), path, lasted, recording))
    note = (
        "Scenario, method and number of the episode, with noise on the motors’ measured speeds. "
        "A recording in the folder of results opens with"
    )
    header = ("episode", "outcome", "path length", "lasted", "recording")
    return ReportTable("Episodes", note, "rerun FILE.rrd", header, rows)


def result_tables(results: Path) -> Iterator[ReportTable]:
    """Return the tables of all results that exist."""
    for name, title in _EXPERIMENTS.items():
        if RESULTS[name].exists(results):
            yield learning_table(title, read_experiment(name, results))
    if RESULTS["transfer"].exists(results):
        yield transfer_table(read_result("transfer", results, Report))
    if (episodes := episode_table(results)).rows:
        yield episodes


def played(results: Path, out: Path) -> str:
    """Write a page that plays a learnt policy of a pair; return its name.

    "" if none was learnt, or without the extra `build`, which compiles the page.
    """
    for method in reversed(DRIVEN_BY):
        policy = RESULTS[episodes_of(PLAYED, method)].location(results) / "policy.npz"
        if policy.is_file() and find_spec("ziglang"):
            write_page(out / PLAY, PLAYED, policy=policy)
            return PLAY
    return ""


def timing_table(timings: TimingsFile) -> ReportTable:
    """Return the table of the times of a reproduction's stages."""
    rows = [
        (name, f"{s.seconds:.1f} s", str(s.attempts), "" if s.finished else "not finished")
        for name, s in timings.stages.items()
    ]
    total = sum(stage.seconds for stage in timings.stages.values())
    note = (
        f"Wall-clock time on {timings.cores} cores, profile “{timings.profile['name']}”; "
        "a stage that was interrupted and continued counts with all its attempts."
    )
    rows.append(("all", f"{total:.1f} s", "", ""))
    header = ("stage", "time", "attempts", "")
    return ReportTable("Time", note, "minirobots reproduce", header, rows)


def write_report(results: Path, figures: Path, out: Path) -> Path:
    """Write the page and what it needs from folders of results and figures, and return it."""
    if not results.is_dir():
        raise UserError(f"{results}: no such folder; make results with `minirobots reproduce`")
    timings = read_timings(results)
    brief = timings is not None and timings.profile.get("name") != FULL.name
    pictures = list(_pictures(figures, out))
    claims = claim_rows((picture["caption"] for picture in pictures), brief=brief)
    write_json(out / CLAIMS, claims)
    content = {
        "brief": brief,
        "pictures": pictures,
        "claims": claims,
        "labels": {picture["caption"].figure: picture["label"] for picture in pictures},
        "missing": not_drawn(figures, results, timings),
        "tables": list(result_tables(results)),
        "profile": timings and timings.profile,
        "timing": timings and timing_table(timings),
        "play": played(results, out),
        "parameters": CoSimConfig().table(),
        "versions": versions(),
        "board_cm": 100.0 * find_scenario("2").size_m[0],
        "robot": TABLE_I,
        "clock": TIMING,
        "noise": SPEED_NOISE.relative_amplitude,
    }
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("analysis.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    write_whole(out / PAGE, environment.get_template("report.html.j2").render(content) + "\n")
    return out / PAGE


def _pictures(figures: Path, out: Path) -> Iterator[dict[str, Any]]:
    """Copy the figures that have been drawn next to the page, in the paper's order."""
    for name in figure_entries():
        try:
            caption = read_caption(figures, name)
        except FileError:
            continue
        files = [f"figures/{name}{ending}" for ending in FORMATS]  # relative to the page
        for file in files:
            with replacing(out / file) as temporary:
                shutil.copyfile(figures / Path(file).name, temporary)
        number = name.removeprefix("fig")
        label = f"Fig. {int(number)}" if number.isdecimal() else name.replace("_", " ").capitalize()
        yield {"label": label, "caption": caption, "png": files[0], "pdf": files[1]}


def not_drawn(figures: Path, results: Path, timings: TimingsFile | None) -> dict[str, list[str]]:
    """Figures that have not been drawn, with the commands (of a reproduction: its own) for them."""
    commands = {}
    for name, entry in figure_entries().items():
        if not (figures / f"{name}.json").is_file():
            needed = [result.command(Path("results")) for result in missing(entry.inputs, results)]
            if needed and timings:
                quick = " --quick" if timings.profile.get("name") == "quick" else ""
                needed = [f"minirobots reproduce --out . --seed {timings.seed}{quick}"]
            drawing = f"minirobots figures {name} --results results --out figures"
            commands[name] = [*needed, drawing]
    return commands

"""Show what a recording contains, and where it looks wrong."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import tyro

from cosim.base.progress import Progress
from minirobots.options import CommandOptions

# Facts shown first; the others follow.
_FIRST_FACTS = ("scenario", "title", "episode", "seed", "starts")


class Inspect(CommandOptions):
    """Print the content of a recorded episode, and its anomalies.

    Prints what was run, the outcome, every robot's path and moves, statistics of every signal, and
    findings with the time at which to look. What looks wrong: no success, a recording that was cut
    off, robots that touch, moves given up, voltages at their limit for long. What robots that reach
    their targets also do: feet slide and lift off, robots pass closely. Also reads what a killed
    run left (.rrd.part).
    """

    recording: Annotated[Path, tyro.conf.Positional]
    """Recording of an episode (.rrd or .rrd.part)."""
    parameters: bool = False
    """Also list every parameter with its unit and source."""


def run(options: Inspect, _: Progress) -> Iterator[Any]:
    """Read the recording, search it for anomalies and print them."""
    from rich.console import Console
    from rich.table import Table

    from analysis.reading.inspection import inspect_episode
    from cosim.base.table import Column, field, show
    from cosim.recording.reader import read_episode

    found = inspect_episode(read_episode(options.recording))
    yield found
    console = Console()
    if not console.is_terminal:  # a file takes whole lines; a terminal has its own width
        console = Console(width=150)
    ending = found.outcome or "not recorded: the recording ends before the episode"
    console.print(f"[bold]{found.recording}[/]", soft_wrap=True)
    console.print(f"outcome {ending}, {found.time_s:.2f} s simulated")
    if not found.complete:
        console.print("its writer was stopped; this is what it had written")
    facts = found.facts
    for key in [*_FIRST_FACTS, *(key for key in facts if key not in _FIRST_FACTS)]:
        if key in facts:
            console.print(f"  {key}: {facts[key]}", soft_wrap=True, markup=False)
    for robot, row in found.robots.items():
        length = row.path_length_m
        path = f"{100.0 * length:.1f} cm, " if length is not None else ""
        console.print(
            f"  {robot}: {path}{row.moves} moves, {row.moves_ended} ended, "
            f"{row.moves_timed_out} timed out"
        )
    if options.parameters:
        table = Table("parameter", "value", "unit", "meaning", "source", title="parameters")
        for name, p in found.parameters.items():
            table.add_row(name, f"{p['value']}", p["unit"], p["description"], p["source"])
        console.print(table)
    measures = [field(name, "{:.4g}") for name in ("minimum", "mean", "maximum", "deviation")]
    columns = (
        field("signal"),
        field("component", heading="of"),
        field("unit"),
        field("samples"),
        Column("every", lambda row: f"{row.period_s:g} s" if row.period_s else "–"),
        *measures,
    )
    layout = {"names": 3, "title": "signals", "numbers": len(measures)}
    show(columns, found.signals, **layout, console=console)
    if not any(finding.wrong for finding in found.findings):
        console.print("nothing looks wrong")
    for wrong, title in ((True, "what looks wrong"), (False, "what successful robots also do")):
        table = Table(title, "where", "at", "")
        for finding in found.findings:
            if finding.wrong == wrong:
                at = f"{finding.time_s:.2f} s" if finding.time_s is not None else "–"
                table.add_row(finding.kind, finding.where, at, finding.text)
        if table.row_count:
            console.print(table)

"""`python -m analysis.inspect FILE.rrd`: what a recording holds and where it looks wrong."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from analysis.reading.findings import find
from cosim.base.command import show_table
from cosim.base.errors import run_command
from cosim.navigation.measures import PATH_SAMPLING_S
from cosim.reading.episode import Episode, read_episode
from cosim.reading.rrd import Signal

# Facts shown first; the others follow.
_FIRST_FACTS = ("scenario", "title", "episode", "seed", "starts")


@dataclass(frozen=True)
class Inspect:
    """Say what a recorded episode holds, and where something in it looks wrong.

    Prints what was run, the outcome, every robot's path and moves, statistics of every signal, and
    findings with the time at which to look: voltages at their limit, sliding feet, feet in the
    air, robots that nearly or really touch, moves given up. Also reads what a killed run left
    (.rrd.part).
    """

    recording: Annotated[Path, tyro.conf.Positional]
    """Recording of an episode (.rrd or .rrd.part)."""
    parameters: bool = False
    """Also list every parameter with its unit and source."""
    json: bool = False
    """Print a JSON object as the last line of output."""


def statistics(path: str, signal: Signal) -> list[dict[str, Any]]:
    """Statistics of each component of a signal."""
    columns = signal.values.reshape(len(signal.time_s), -1)
    named = len(signal.components) == columns.shape[1]
    rows = []
    for k, column in enumerate(columns.T):
        known = column[np.isfinite(column)]
        rows.append(
            {
                "signal": path,
                "component": signal.components[k] if named else str(k),
                "unit": signal.unit,
                "samples": len(column),
                "period_s": _period(signal.time_s),
                **{
                    name: float(function(known)) if len(known) else None
                    for name, function in (
                        ("minimum", np.min),
                        ("mean", np.mean),
                        ("maximum", np.max),
                        ("deviation", np.std),
                    )
                },
            }
        )
    return rows


def _period(time_s: np.ndarray) -> float | None:
    """Time between two samples, as far as the gaps between bursts do not matter."""
    return round(float(np.median(np.diff(time_s))), 9) if len(time_s) > 1 else None


def path_length_m(episode: Episode, robot: str) -> float | None:
    """Length of a robot's path, sampled as slowly as the co-simulation does: without vibration."""
    position = episode.signals.get(f"/sim/{robot}/position")
    period_s = _period(position.time_s) if position is not None else None
    if position is None or period_s is None:
        return None
    every = max(1, round(PATH_SAMPLING_S / period_s))
    path = position.values[every - 1 :: every, :2]
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def report(episode: Episode) -> dict[str, Any]:
    """Everything that the command prints, as plain values."""
    return {
        "recording": str(episode.path),
        "recording_id": episode.recording_id,
        "complete": episode.complete,
        "outcome": episode.outcome or None,
        "time_s": episode.time_s,
        "facts": dict(episode.facts),
        "parameters": {name: p._asdict() for name, p in episode.parameters.items()},
        "robots": {
            robot: {
                "path_length_m": path_length_m(episode, robot),
                "moves": len(episode.moves[robot]),
                "moves_ended": sum(move.ended for move in episode.moves[robot]),
                "moves_timed_out": sum(move.given_up for move in episode.moves[robot]),
            }
            for robot in episode.robots
        },
        "signals": [
            row
            for path, signal in episode.signals.items()
            if not path.startswith("/world/")
            for row in statistics(path, signal)
        ],
        "findings": [finding._asdict() for finding in find(episode)],
    }


def show(content: dict[str, Any], console: Console, parameters: bool) -> None:
    """Print a report."""
    ending = content["outcome"] or "not recorded: the recording ends before the episode"
    console.print(f"[bold]{content['recording']}[/]", soft_wrap=True)
    console.print(f"outcome {ending}, {content['time_s']:.2f} s simulated")
    if not content["complete"]:
        console.print("its writer was stopped; this is what it had written")
    facts = content["facts"]
    for key in [*_FIRST_FACTS, *(key for key in facts if key not in _FIRST_FACTS)]:
        if key in facts:
            console.print(f"  {key}: {facts[key]}", soft_wrap=True, markup=False)
    for robot, row in content["robots"].items():
        length = row["path_length_m"]
        path = f"{100.0 * length:.1f} cm, " if length is not None else ""
        console.print(
            f"  {robot}: {path}{row['moves']} moves, {row['moves_ended']} ended, "
            f"{row['moves_timed_out']} timed out"
        )
    if parameters:
        table = Table("parameter", "value", "unit", "meaning", "source", title="parameters")
        for name, p in content["parameters"].items():
            table.add_row(name, f"{p['value']}", p["unit"], p["description"], p["source"])
        console.print(table)
    measures = ("minimum", "mean", "maximum", "deviation")
    rows = [
        (
            row["signal"],
            row["component"],
            row["unit"],
            str(row["samples"]),
            f"{row['period_s']:g} s" if row["period_s"] else "–",
            *(_number(row[name]) for name in measures),
        )
        for row in content["signals"]
    ]
    header = ("signal", "of", "unit", "samples", "every", *measures)
    show_table(console, header, rows, names=3, title="signals", numbers=len(measures))
    table = Table("what looks wrong", "where", "at", "")
    for finding in content["findings"]:
        at_s = finding["time_s"]
        at = f"{at_s:.2f} s" if at_s is not None else "–"
        table.add_row(finding["kind"], finding["where"], at, finding["text"])
    console.print(table if content["findings"] else "nothing looks wrong")


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"


def main() -> None:
    """Command line; see `Inspect`."""
    options = tyro.cli(
        Inspect, prog="python -m analysis.inspect", config=(tyro.conf.FlagCreatePairsOff,)
    )
    content = report(read_episode(options.recording))
    # A file takes whole lines; a terminal has its own width.
    console = Console()
    show(content, console if console.is_terminal else Console(width=150), options.parameters)
    if options.json:
        print(json.dumps(content))


if __name__ == "__main__":
    run_command(main)

"""Options that mean the same everywhere, declared once: each with its type, limits and help.

A record of options is a frozen dataclass: its fields are keywords of a function in Python, and the
command line that calls it. Nothing here is slow to import, so that every `--help` comes at once.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from msgspec import Meta

from cosim.base.arguments import MAX_SEED, validate_fields
from cosim.base.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Checked:
    """Base of records of options: the types, with their limits, are checked when one is made."""

    def __post_init__(self) -> None:
        validate_fields(self)


def record_of(kind: Any, given: Mapping[str, Any]) -> tuple[Any, dict[str, Any]]:
    """Return a record of the keywords of a call, those of its own records too, and the others."""
    found, others = {}, dict(given)
    for option in fields(kind):
        if is_dataclass(option.default):
            found[option.name], others = record_of(type(option.default), others)
        elif option.name in others:
            found[option.name] = others.pop(option.name)
    return kind(**found), others


Count = Annotated[int, Meta(ge=1, le=MAX_SEED - 1)]
NotNegative = Annotated[int, Meta(ge=0, le=MAX_SEED - 1)]
Positive = Annotated[float, Meta(gt=0, le=1e12)]
Seconds = Annotated[float, tyro.conf.arg(metavar="S")]
File = Annotated[Path, tyro.conf.arg(metavar="FILE")]
OptionalFile = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]
Folder = Annotated[Path, tyro.conf.arg(metavar="DIR")]
Seed = Annotated[NotNegative, tyro.conf.arg(help="Seed of everything that is drawn at random.")]
Jobs = Annotated[
    int,
    tyro.conf.arg(
        metavar="N",
        help="What runs at the same time, -1 for one per core; the results do not depend on it.",
    ),
]
BudgetMinutes = Annotated[
    Annotated[float, Meta(ge=0)] | None,
    tyro.conf.arg(
        metavar="M",
        help="Start nothing new after this time in minutes; the same command resumes. By default "
        "without limit.",
    ),
]
NewFolder = Annotated[
    Path | None,
    tyro.conf.arg(
        metavar="DIR",
        help="Output folder; by default a new one in runs/, named by the command's subject and the "
        "time.",
    ),
]
MethodName = Annotated[
    str, tyro.conf.arg(metavar="{paper,double_q,moves,shortest,fastest,planned,MODULE:NAME}")
]
ScenarioName = Annotated[
    str,
    tyro.conf.arg(
        help="Built-in scenario (1a, 1b, 2, 3, 4 of Fig. 5, and 1a-zone to 4-zone with the zone "
        "forbidden; 5-corridor, 5-slalom, 5-doorway; 4-cross, 4-ring, 6-swap; swarm-16, swarm-64, "
        "swarm-256, swarm-1024) or a scenario file (.toml)."
    ),
]
MACHINES = (
    "paper (Tables I and II), droplet, hexbug, icra2006, kilobot, pogobot-brush, pogobot-rigid, "
    "thesis, or a file (.toml, see docs/own.md)"
)
PresetName = Annotated[str, tyro.conf.arg(metavar="NAME|FILE", help=f"Machine: {MACHINES}.")]
Friction = Annotated[
    Positive | None,
    tyro.conf.arg(help="Friction coefficient; by default the preset's, 0.15 for the paper."),
]
MotorFmuFile = Annotated[
    Path | None,
    tyro.conf.arg(
        metavar="FILE",
        help="Motor FMU to use (FMI 3.0 Co-Simulation with the same interface) instead of the "
        "built-in.",
    ),
]


def _parse_pair(texts: list[str]) -> tuple[str, float]:
    name, _, value = texts[0].partition("=")
    return name, float(value)


NamedNumber = Annotated[
    tuple[str, float],
    tyro.constructors.PrimitiveConstructorSpec(
        nargs=1,
        metavar="NAME=VALUE",
        instance_from_str=_parse_pair,
        is_instance=lambda pair: isinstance(pair, tuple),
        str_from_instance=lambda pair: [f"{pair[0]}={pair[1]:g}"],
    ),
]
MotorParameters = Annotated[
    tuple[NamedNumber, ...],
    tyro.conf.arg(
        name="motor-parameter",
        help="Parameter of the motor FMU to set through FMI, in the FMU's unit, such as J=5e-9; "
        "repeat it for several. By default the FMU's own values hold.",
    ),
    tyro.conf.UseAppendAction,
]


def workers(jobs: int) -> int:
    """Threads or processes for `--jobs`."""
    if jobs == -1:
        from joblib import cpu_count

        return cpu_count()
    if jobs < 1:
        raise UserError("--jobs must be at least 1, or -1 for one per core")
    return jobs

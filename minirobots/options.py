"""Options that several commands have, each declared once: its type, its limits and its help."""

import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, fields
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import (
    Annotated,
    Any,
    ClassVar,
    NamedTuple,
    Self,
    dataclass_transform,
    get_args,
    get_type_hints,
)

import tyro

from cosim.base.command import Jobs as JobCount
from cosim.base.command import Json, require_at_least, workers
from cosim.base.errors import UserError
from cosim.base.jobs import Workers
from cosim.base.storage import lock_folder, new_folder, require_suffix
from cosim.model.scenario_file import find_scenario
from cosim.simulation.options import SimulationOptions


class Check(NamedTuple):
    """A limit of an option, declared with its type.

    Attributes:
        require: called with the option's name and value, raises UserError if it is refused.
    """

    require: Callable[[str, Any], object]


def at_least(least: int) -> Check:
    """Return the check of a number that is at least `least`; None passes."""
    return Check(lambda name, value: require_at_least(least, **{name: value}))


def _positive(name: str, value: float | None) -> None:
    if value is not None and not 0.0 < value < math.inf:
        raise UserError(f"--{name.replace('_', '-')} {value:g} must be positive and finite")


def ending(suffix: str) -> Check:
    """Return the check of a file to write: its name ends in a suffix; None passes."""
    return Check(lambda _, path: path is None or require_suffix(path, suffix))


Positive = Annotated[float, Check(_positive)]
Count = Annotated[int, at_least(1)]
NotNegative = Annotated[int, at_least(0)]
Seconds = Annotated[float, tyro.conf.arg(metavar="S")]
Seed = Annotated[
    int, at_least(0), tyro.conf.arg(help="Seed of everything that is drawn at random.")
]
Jobs = Annotated[JobCount, Check(lambda _, jobs: jobs == -1 or workers(jobs))]
BudgetMinutes = Annotated[
    float | None,
    at_least(0),
    tyro.conf.arg(
        metavar="M",
        help="Start nothing new after this time in minutes; the same command resumes. By default "
        "without limit.",
    ),
]
File = Annotated[Path, tyro.conf.arg(metavar="FILE")]
Folder = Annotated[Path, tyro.conf.arg(metavar="DIR")]
ScenarioName = Annotated[
    str,
    tyro.conf.arg(
        help="Built-in scenario (1a, 1b, 2, 3, 4 of Fig. 5, and 1a-zone to 4-zone with the zone "
        "forbidden; 5-corridor, 5-slalom, 5-doorway; 4-cross, 4-ring, 6-swap; swarm-16, swarm-64, "
        "swarm-256, swarm-1024) or a scenario file (.toml)."
    ),
]
PresetName = Annotated[
    str,
    tyro.conf.arg(
        metavar="NAME|FILE", help="Machine: paper, icra2006, thesis, or a preset file (.toml)."
    ),
]

Friction = Annotated[
    Positive | None,
    tyro.conf.arg(help="Friction coefficient; by default the preset's, 0.15 for the paper."),
]


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(field,))
class _Declared:
    """Makes every subclass a frozen dataclass with fields that are given by name."""

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True, kw_only=True)(cls)


class CommandOptions(_Declared):
    """Base of every command's options: frozen dataclasses, without the decorator."""

    json: Json = False

    def __post_init__(self) -> None:
        for name, kind in get_type_hints(type(self), include_extras=True).items():
            value = getattr(self, name)
            for check in _checks(kind):
                for each in value if isinstance(value, tuple) else (value,):
                    check.require(name, each)

    def arguments(self, *without: str, **others: Any) -> dict[str, Any]:
        """Return the options by name, as arguments of a function.

        Args:
            without: names that are left out, as those of `json`, `isolate` and `physics` are.
            others: names that are replaced or added.
        """
        names = {option.name for option in fields(self)}
        names -= {"json", "isolate", "physics", *without}
        return {name: getattr(self, name) for name in names} | others

    def interrupted(self) -> str:
        """Return the message after Ctrl-C, empty by default."""
        return ""

    def alone(self) -> AbstractContextManager[None]:
        """Keep other runs out of the output folder, if they would spoil each other's results."""
        return nullcontext()

    @classmethod
    def defaults(cls, _arguments: list[str]) -> Self | None:
        """Return defaults that the command line changes; None for those of the class."""
        return None


def _checks(kind: Any) -> Iterator[Check]:
    for part in get_args(kind):
        if isinstance(part, Check):
            yield part
        else:
            yield from _checks(part)


class IsolatedOptions(CommandOptions):
    """Options of a command that loads FMUs, which may be foreign ones."""

    isolate: bool = False
    """Run in a process of its own, so that an FMU that crashes ends the command with an error that
    names it. Use it for FMUs that you do not know well."""

    @property
    def foreign(self) -> Path | None:
        """FMU that is not built in, if any."""
        options: Any = getattr(self, "physics", self)
        return options.motor_fmu


class Simulating(IsolatedOptions):
    """Options of a command that simulates episodes."""

    physics: Annotated[SimulationOptions, tyro.conf.OmitArgPrefixes] = field(
        default_factory=SimulationOptions
    )


class Distributed(CommandOptions):
    """Options of a command with jobs that other processes and machines can compute."""

    where: Annotated[Workers, tyro.conf.OmitArgPrefixes] = field(default_factory=Workers)


class NewFolder(CommandOptions):
    """Options of a command that writes to a folder of its own."""

    prefix: ClassVar[str] = ""

    out: Folder | None = None
    """Output folder; by default a new one in runs/, named by the command's subject and the time."""

    @property
    def subject(self) -> str:
        """Return what the results are of."""
        return find_scenario(vars(self)["scenario"]).name

    @cached_property
    def folder(self) -> Path:
        """Output folder; a new one is made at once, so that no other run takes its name."""
        name = f"{self.prefix}{self.subject}-{datetime.now():%Y%m%d-%H%M%S}"
        return self.out or new_folder(Path("runs") / name)

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Keep other runs out of the output folder, and remove a new one that stays empty."""
        new = self.out is None or not self.out.exists()
        try:
            with lock_folder(self.folder):
                yield
        finally:
            if new:
                with suppress(OSError):
                    self.folder.rmdir()


class Resumable(CommandOptions):
    """Options of a command that continues where an interrupt ended it."""

    def interrupted(self) -> str:
        """Return where the results are."""
        out: Path = getattr(self, "folder", getattr(self, "out", Path()))
        return f"results so far are in {out}/; the same command continues"

"""What the command lines share: parsing, and options that mean the same wherever they stand.

Modules with commands import only what their options need; `main` imports the rest, so that every
`--help` comes at once.
"""

import os
import sys
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast

import msgspec
import tyro

from cosim.base.errors import UserError

Options = TypeVar("Options")

Json = Annotated[bool, tyro.conf.arg(help="Print a JSON object as the last line of output.")]
Jobs = Annotated[
    int,
    tyro.conf.arg(
        metavar="N",
        help="What runs at the same time, -1 for one per core; the results do not depend on it.",
    ),
]
MotorFmuFile = Annotated[
    Path | None,
    tyro.conf.arg(
        metavar="FILE",
        help="Motor FMU to use (FMI 3.0 Co-Simulation with the same interface) instead of the "
        "built-in.",
    ),
]


def parse(
    options: type[Options],
    module: str,
    arguments: list[str] | None = None,
    default: Options | None = None,
) -> Options:
    """Options of a command line.

    Args:
        options: dataclass whose docstrings are the help.
        module: of the command; `minirobots` names it by its sub-command.
        arguments: of the command line, by default those of the process.
        default: what the command line changes, instead of the dataclass's own defaults.
    """
    called = sys.argv[0] if sys.argv[0].startswith("minirobots ") else f"python -m {module}"
    config = (tyro.conf.FlagCreatePairsOff,)
    return cast(
        Options, tyro.cli(options, prog=called, args=arguments, default=default, config=config)
    )


def workers(jobs: int) -> int:
    """Threads or processes for `--jobs`.

    Raises:
        UserError: it is neither -1 nor positive.
    """
    if jobs == -1:
        return os.cpu_count() or 1
    if jobs < 1:
        raise UserError("--jobs must be at least 1, or -1 for one per core")
    return jobs


def print_json(content: Any) -> None:
    """Print what `--json` promises: one object on one line."""
    print(msgspec.json.encode(content).decode())

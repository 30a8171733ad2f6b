"""Common parts of the command lines: parsing, and options that mean the same everywhere.

Modules with commands import only what their options need; `main` imports the rest, so that every
`--help` comes at once.
"""

import contextlib
import io
import json
import re
import sys
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast

import msgspec
import tyro

from cosim.base.arguments import MAX_SEED
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


def _named_number(texts: list[str]) -> tuple[str, float]:
    name, _, value = texts[0].partition("=")
    return name, float(value)


NamedNumber = Annotated[
    tuple[str, float],
    tyro.constructors.PrimitiveConstructorSpec(
        nargs=1,
        metavar="NAME=VALUE",
        instance_from_str=_named_number,
        is_instance=lambda pair: isinstance(pair, tuple),
        str_from_instance=lambda pair: [f"{pair[0]}={pair[1]:g}"],
    ),
]
MotorParameters = Annotated[
    tuple[NamedNumber, ...], tyro.conf.arg(name="motor-parameter"), tyro.conf.UseAppendAction
]


def parse(
    options: type[Options],
    program: str,
    arguments: list[str] | None = None,
    default: Options | None = None,
) -> Options:
    """Options of a command line.

    Args:
        options: dataclass; its docstrings are the help.
        program: with which the usage begins, such as "minirobots run".
        arguments: of the command line, by default those of the process.
        default: what the command line changes, instead of the dataclass's own defaults.
    """
    config = (tyro.conf.FlagCreatePairsOff,)
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            parsed = tyro.cli(options, prog=program, args=arguments, default=default, config=config)
    except SystemExit as end:
        # tyro takes a ConfigError, as every ValueError, for its own
        error: BaseException | None = end
        while error is not None and not isinstance(error, UserError):
            error = error.__context__
        if error is not None:
            raise error from None
        sys.stderr.write(said.getvalue())
        raise
    return cast(Options, parsed)


def workers(jobs: int) -> int:
    """Threads or processes for `--jobs`."""
    if jobs == -1:
        from joblib import cpu_count

        return cpu_count()
    if jobs < 1:
        raise UserError("--jobs must be at least 1, or -1 for one per core")
    return jobs


def require_at_least(least: int, **options: float | None) -> None:
    """Refuse options below a number, and NaN; None is one that was not given."""
    for name, value in options.items():
        if value is not None and not value >= least:
            must = f"be at least {least}" if least else "not be negative"
            raise UserError(f"--{name.replace('_', '-')} must {must}")
        if value is not None and value >= MAX_SEED:
            raise UserError(f"--{name.replace('_', '-')} must be below 2**63")


def print_json(content: Any) -> None:
    """Print what `--json` promises: one object on one line, in ASCII for any terminal."""
    text = msgspec.json.encode(content).decode()
    print(re.sub("[^\0-\x7f]+", lambda found: json.dumps(found[0])[1:-1], text))

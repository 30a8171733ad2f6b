"""What all commands of `minirobots` have in common: options, output, exit status."""

import contextlib
import inspect
import io
import json
import os
import re
import signal
import subprocess
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Generic, Self, TypeVar

import msgspec
import tyro
from tyro.extras import SubcommandApp

from cosim.base.command import Checked
from cosim.base.errors import Terminated, UserError, run_command
from cosim.base.progress import Progress, progress_bars
from cosim.base.storage import lock_folder, new_folder
from minirobots.commands import COMMANDS, class_of

FAILED_STATUS = 1
_CHILD = "MINIROBOTS_ISOLATED"  # in the environment of a child, see `isolate`
RESUMES = "results so far are in {out}/; the same command continues"
Options = TypeVar("Options")


class Output:
    """What a command gives.

    Args:
        result: what `--json` prints, as an object.
        parts: what is printed for people: lines, and functions that print tables; by default the
            entries of the result.
        failed: whether the exit status is 1.
    """

    def __init__(
        self, result: Any, *parts: str | Callable[[], object], failed: bool = False
    ) -> None:
        self.result, self.parts, self.failed = result, parts or (*_entries(result),), failed

    def show(self) -> None:
        """Print the parts."""
        for part in self.parts:
            if isinstance(part, str):
                print(part)
            else:
                part()


def _entries(result: dict[str, Any]) -> Iterator[str]:
    for name, value in result.items():
        words = ", ".join(map(str, value)) if isinstance(value, list) else value
        yield f"{name.replace('_', ' ')}: {words}"


@dataclass(frozen=True, kw_only=True)
class Command(Checked, ABC):
    """Base of commands: fields are options, docstrings are the help.

    Attributes:
        kept: what is printed after Ctrl-C.
    """

    kept = ""

    @classmethod
    def defaults(cls, _arguments: list[str]) -> Self | None:
        """Return options that the command line changes, where they are not the class's own."""
        return None

    @abstractmethod
    def run(self, progress: Progress) -> Output:
        """Do the work; `progress` receives what takes long."""

    def interrupted(self) -> str:
        """Return what is printed after Ctrl-C."""
        return self.kept.format(**vars(self))

    @contextlib.contextmanager
    def alone(self) -> Iterator[Self]:
        """Yield the command with an output folder that no other run may write to meanwhile.

        A new one is made if `subject` names what it is of, and removed if it stays empty.
        """
        subject, given = self.subject(), getattr(self, "out", None)
        if not subject:
            yield self
            return
        new = given is None or not given.exists()
        out = given or new_folder(Path("runs") / f"{subject}-{datetime.now():%Y%m%d-%H%M%S}")
        try:
            with lock_folder(out):
                yield replace(self, out=out)
        finally:
            if new:
                with contextlib.suppress(OSError):
                    out.rmdir()

    def subject(self) -> str:
        """Return the beginning of a new output folder's name; nothing if there is none."""
        return ""


@dataclass(frozen=True, kw_only=True)
class Line(Generic[Options]):
    """A command line: a record of options, and what every command has."""

    options: Annotated[Options, tyro.conf.arg(name="")]
    json: bool = False
    """Print a JSON object as the last line of output."""


@dataclass(frozen=True, kw_only=True)
class IsolatedLine(Line[Options]):
    """The command line of a command that loads FMUs, which may be foreign ones."""

    isolate: bool = False
    """Run in a process of its own, so that an FMU that crashes ends the command with an error that
    names it. Use it for FMUs that you do not know well."""


def line_of(options: Any) -> Any:
    """Return the type of a command line with a record of options."""
    with_fmu = {"motor_fmu", "physics"} & {field.name for field in fields(options)}
    return IsolatedLine[options] if with_fmu else Line[options]


def parse(
    kind: type[Options],
    program: str,
    arguments: list[str] | None = None,
    default: Options | None = None,
) -> Line[Options]:
    """Return the options of a command line; what it leaves out is that of `default`, if any."""
    line, text = line_of(kind), io.StringIO()
    try:
        with contextlib.redirect_stderr(text):
            return tyro.cli(
                line,
                prog=program,
                description=inspect.getdoc(kind),
                args=arguments,
                default=None if default is None else line(options=default),
                config=(tyro.conf.FlagCreatePairsOff,),
            )
    except SystemExit as end:
        # tyro takes a ConfigError, as every ValueError, for its own
        error: BaseException | None = end
        while error is not None and not isinstance(error, UserError):
            error = error.__context__
        if error is not None:
            raise error from None
        name = program.rpartition(" ")[2]
        if "Unrecognized options" in text.getvalue() and name in COMMANDS:
            parse_all([name, *(arguments or ())])  # ends with what says which command has them
        sys.stderr.write(text.getvalue())
        raise


def parse_all(arguments: list[str]) -> None:
    """Parse a command line with all commands known, for its completion or its errors; then end."""
    app: Any = SubcommandApp()
    for command in COMMANDS:
        app.command(line_of(class_of(command)), name=command)
    app.cli(prog="minirobots", args=arguments, config=(tyro.conf.FlagCreatePairsOff,))


def run_named(name: str) -> None:
    """Run a command with the arguments of this process, and leave with its exit status."""
    run_command(lambda: execute(name))


def execute(name: str) -> None:
    """Parse the arguments of this process, do the work, print what came of it."""
    kind, arguments = class_of(name), sys.argv[1:]
    try:
        line = parse(kind, f"minirobots {name}", arguments, kind.defaults(arguments))
    except SystemExit as end:
        if not end.code and (examples := _examples(name)):  # after --help
            print("\nexamples:", *examples, sep="\n  ")
        raise
    if isinstance(line, IsolatedLine) and line.isolate:
        isolate(f"minirobots {name}", getattr(line.options, "physics", line.options).motor_fmu)
    with line.options.alone() as command:
        try:
            with progress_bars() as progress:
                output = command.run(progress)
        except KeyboardInterrupt:
            if text := command.interrupted():
                print(text, file=sys.stderr)
            raise
        output.show()
    if line.json:
        print_json(output.result)
    if output.failed:
        sys.exit(FAILED_STATUS)


def isolate(command: str, fmu: Path | None) -> None:
    """Run this process's command again in a child process; return only in that child.

    An FMU is native code: one that crashes ends the child, and the command with a one-line error.
    This holds faults, not malice: the child may do what the user may.

    Ctrl-C and SIGTERM reach the child once. Ctrl-C again kills it, if an FMU does not return.
    """
    from cosim.fmi.fmu import FmuError

    if _CHILD in os.environ:
        from cosim.base.backends import end_with  # slow to import

        end_with(int(os.environ[_CHILD]))
        return
    line = [sys.executable, "-m", *command.split(), *sys.argv[1:]]
    interrupted: KeyboardInterrupt | None = None
    # A session of its own: a terminal's Ctrl-C reaches the child through this process alone.
    env = os.environ | {_CHILD: str(os.getpid())}
    with subprocess.Popen(line, env=env, start_new_session=True) as child:
        while child.poll() is None:
            try:
                child.wait()
            except KeyboardInterrupt as interrupt:
                ended = signal.SIGTERM if isinstance(interrupt, Terminated) else signal.SIGINT
                child.send_signal(signal.SIGKILL if interrupted else ended)
                interrupted = interrupt
    if child.returncode >= 0:
        sys.exit(child.returncode)
    if interrupted:
        raise interrupted
    raise FmuError(
        f"{f'motor FMU {fmu}' if fmu else 'the built-in motor FMU'} crashed "
        f"({signal.Signals(-child.returncode).name}), and the command with it; "
        "export the FMU again, or use the built-in one"
    )


def print_json(content: Any) -> None:
    """Print what `--json` promises: one object on one line, in ASCII for any terminal."""
    text = msgspec.json.encode(content).decode()
    print(re.sub("[^\0-\x7f]+", lambda found: json.dumps(found[0])[1:-1], text))


def _examples(name: str) -> list[str]:
    """Return the lines of commands.md, a page of the site, that show a command."""
    page = Path(__file__).with_name("commands.md").read_text("utf-8")
    return re.findall(rf"^uv run (?:--extra \w+ )?(minirobots {name} .*)$", page, re.MULTILINE)

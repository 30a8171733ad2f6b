"""Runs a command of `minirobots.commands`: what the modules there have in common."""

import re
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from cosim.base.command import parse, print_json
from cosim.base.errors import run_command
from cosim.base.progress import Progress, progress_bars
from cosim.fmi.isolation import isolate
from minirobots.options import CommandOptions, IsolatedOptions

FAILED_STATUS = 1


def module_of(name: str) -> ModuleType:
    """Return the module of a command."""
    return import_module(f"minirobots.commands.{name.replace('-', '_')}")


def options_of(module: ModuleType) -> type[Any]:
    """Return the class of a command's options, which its function `run` names."""
    return module.run.__annotations__["options"]


def run_named(name: str) -> None:
    """Run a command with the arguments of this process, and leave with its exit status."""
    run_command(lambda: execute(name))


def execute(name: str) -> None:
    """Parse the arguments of this process, do the work, print what came of it.

    Args:
        name: of the command.

    Raises:
        SystemExit: the command failed in its own terms, or a child process has done the work.
    """
    command = module_of(name)
    kind, arguments = options_of(command), sys.argv[1:]
    try:
        options: CommandOptions = parse(
            kind, f"minirobots {name}", arguments, kind.defaults(arguments)
        )
    except SystemExit as end:
        if not end.code and (examples := _examples(name)):  # after --help
            print("\nexamples:", *examples, sep="\n  ")
        raise
    if isinstance(options, IsolatedOptions) and options.isolate:
        isolate(f"minirobots {name}", options.foreign)
    with options.alone():
        try:
            with progress_bars() as progress:
                result = next(printing := begin(command, options, progress))
        except KeyboardInterrupt:
            if said := options.interrupted():
                print(said, file=sys.stderr)
            raise
        for _ in printing:
            pass
        if options.json:
            print_json(result)
    if hasattr(command, "failed") and command.failed(result):
        sys.exit(FAILED_STATUS)


def begin(command: ModuleType, options: CommandOptions, progress: Progress) -> Iterator[Any]:
    """Return an iterator that does a command's work, yields its result, and then prints it."""
    result = command.run(options, progress)
    return _printed(result) if isinstance(result, dict) else result


def _printed(result: dict[str, Any]) -> Iterator[Any]:
    """Yield what a command returned, then print it."""
    yield result
    for name, value in result.items():
        words = ", ".join(map(str, value)) if isinstance(value, list) else value
        print(f"{name.replace('_', ' ')}: {words}")


def _examples(name: str) -> list[str]:
    """Return the lines of commands.md, a page of the site, that show a command."""
    page = Path(__file__).with_name("commands.md").read_text("utf-8")
    return re.findall(rf"^uv run (?:--extra \w+ )?(minirobots {name} .*)$", page, re.MULTILINE)

"""`minirobots`: all commands under one name, each loaded when it is called."""

import sys
from pathlib import Path
from typing import Any

from cosim.base.errors import USER_ERROR_STATUS, end_at_interrupt

_COMPLETION = "--tyro-print-completion"


def purposes() -> dict[str, str]:
    """Return the first line of every command's docstring, by the command's name."""
    from minirobots import commands

    found = {}
    for path in sorted(Path(commands.__path__[0]).glob("[a-z]*.py")):
        first = path.read_text("utf-8").split('"""')[1].splitlines()[0]
        found[path.stem.replace("_", "-")] = first
    return found


def main() -> None:
    """Run a command, or list all commands."""
    end_at_interrupt()
    name, *rest = sys.argv[1:] or ["--help"]
    known = purposes()
    if name in {"-h", "--help"}:
        print("usage: minirobots COMMAND [OPTIONS]   (minirobots COMMAND --help lists them)\n")
        for command, purpose in known.items():
            print(f"  {command:<15}{purpose.removesuffix('.')}")
        print(f"\nshell completion: minirobots {_COMPLETION} bash, zsh or tcsh")
    elif name.startswith(_COMPLETION):
        _print_completion(list(known), sys.argv[1:])
    elif name not in known:
        choice = ", ".join(known)
        print(f"error: minirobots has no command {name}; choose one of {choice}", file=sys.stderr)
        sys.exit(USER_ERROR_STATUS)
    else:
        from minirobots.runner import run_named

        sys.argv = [f"minirobots {name}", *rest]
        run_named(name)


def _print_completion(names: list[str], arguments: list[str]) -> None:
    """Print what a shell completes, of all commands at once."""
    from tyro.extras import SubcommandApp

    from minirobots.runner import module_of, options_of

    app: Any = SubcommandApp()
    for name in names:
        app.command(options_of(module_of(name)), name=name)
    app.cli(prog="minirobots", args=arguments)


if __name__ == "__main__":
    main()

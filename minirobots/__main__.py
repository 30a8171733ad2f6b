"""`minirobots`: all commands under one name, each loaded when it is called."""

import sys

from cosim.base.errors import USER_ERROR_STATUS, end_at_interrupt
from minirobots.commands import COMMANDS

_COMPLETION = "--tyro-print-completion"


def main() -> None:
    """Run a command, or list all commands."""
    end_at_interrupt()
    name, *rest = sys.argv[1:] or ["--help"]
    if name in {"-h", "--help"}:
        print("usage: minirobots COMMAND [OPTIONS]   (minirobots COMMAND --help lists them)\n")
        for command, (*_, purpose) in COMMANDS.items():
            print(f"  {command:<15}{purpose}")
        print(f"\nshell completion: minirobots {_COMPLETION} bash, zsh or tcsh")
    elif name.startswith(_COMPLETION):
        from minirobots.runner import parse_all

        parse_all(sys.argv[1:])
    elif name not in COMMANDS:
        choice = ", ".join(COMMANDS)
        print(f"error: minirobots has no command {name}; choose one of {choice}", file=sys.stderr)
        sys.exit(USER_ERROR_STATUS)
    else:
        from minirobots.runner import run_named

        sys.argv = [f"minirobots {name}", *rest]
        run_named(name)


if __name__ == "__main__":
    main()

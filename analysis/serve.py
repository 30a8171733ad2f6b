"""`python -m analysis.serve DIR`: open a report of this machine in its browser."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from cosim.base.command import parse
from cosim.base.errors import run_command


@dataclass(frozen=True)
class Serve:
    """Serve a report to the browser of this machine, until Ctrl-C."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder made by `python -m analysis.report`."""
    port: int = 8000
    """Port to listen on; 0 takes a free one."""


def main() -> None:
    """Command line; see `Serve`."""
    options = parse(Serve, "analysis.serve")
    from analysis.report.server import address, server

    with server(options.folder, options.port) as serving:
        try:
            print(f"report: {address(serving)} (Ctrl-C ends it)", flush=True)
            serving.serve_forever()
        except KeyboardInterrupt:
            print()  # the intended end, after the terminal's ^C


if __name__ == "__main__":
    run_command(main)

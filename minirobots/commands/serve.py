"""Open a report of this machine in its browser."""

from pathlib import Path

import tyro

from cosim.base.progress import Progress
from minirobots.options import CommandOptions


class Serve(CommandOptions):
    """Serve a report to the browser of this machine, until Ctrl-C."""

    folder: tyro.conf.Positional[Path]
    """Folder made by `python -m analysis.report`."""
    port: int = 8000
    """Port to listen on; 0 takes a free one."""


def run(options: Serve, _: Progress) -> dict[str, str]:
    """Serve until Ctrl-C."""
    from analysis.report.server import address, server

    with server(options.folder, options.port) as serving:
        try:
            print(f"report: {address(serving)} (Ctrl-C ends it)", flush=True)
            serving.serve_forever()
        except KeyboardInterrupt:
            print()  # the intended end, after the terminal's ^C
        return {"served": address(serving)}

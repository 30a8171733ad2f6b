"""Serves a report to the browser of this machine.

A browser loads neither the Rerun viewer nor a recording from a page opened as a file; so the folder
is served, to this machine only.
"""

from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from cosim.base.errors import UserError

HOST = "127.0.0.1"
PAGE = "index.html"


class ServeError(UserError):
    """A folder or port that cannot be served."""


class _Handler(SimpleHTTPRequestHandler):
    # WebAssembly is compiled while it loads only under its own type; the system's table of types
    # may know neither it nor scripts.
    extensions_map = SimpleHTTPRequestHandler.extensions_map | {
        ".css": "text/css",
        ".js": "text/javascript",
        ".json": "application/json",
        ".png": "image/png",
        ".rrd": "application/octet-stream",
        ".svg": "image/svg+xml",
        ".wasm": "application/wasm",
    }

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - the base's name
        """Say nothing of requests: the terminal keeps showing the address."""


def server(folder: Path, port: int = 0) -> ThreadingHTTPServer:
    """A server of a report's folder, listening but not yet answering.

    Args:
        folder: made by `analysis.report`.
        port: 0 takes a free one.

    Raises:
        ServeError: the folder holds no report, or the port cannot be had.
    """
    if not (folder / PAGE).is_file():
        raise ServeError(
            f"{folder}: no {PAGE} there; make a report with `python -m analysis.report --out "
            f"{folder}`, or name its folder"
        )
    try:
        return ThreadingHTTPServer((HOST, port), partial(_Handler, directory=str(folder)))
    except (OSError, OverflowError) as error:
        raise ServeError(f"--port {port}: {error}; choose another, or 0 for a free one") from error


def address(of: ThreadingHTTPServer) -> str:
    """URL of a server's page."""
    return f"http://{HOST}:{of.server_address[1]}/"

"""Serves a report to the browser of this machine.

A browser loads neither the Rerun viewer nor a recording from a page opened as a file; so the folder
is served, to this machine only: requests that name another host are refused, as a page of a foreign
site makes them (DNS rebinding), and links do not lead out of the folder.
"""

import re
import sys
from functools import partial
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from cosim.base.errors import UserError

HOST = "127.0.0.1"
_NAMES = {HOST, "localhost"}
_RANGE = re.compile(r"bytes=(?:(\d{1,18})-(\d{1,18})?|-(\d{1,18}))")
PAGE = "index.html"


class ServeError(UserError):
    """Invalid folder or port of a server. The message names the fix."""


class _Server(ThreadingHTTPServer):
    request_queue_size = 1024  # a browser opens many connections at once

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignore clients that leave or stall; report defects."""
        if not isinstance(sys.exception(), (ConnectionError, TimeoutError)):
            super().handle_error(request, client_address)  # pyright: ignore[reportArgumentType]


class _Handler(SimpleHTTPRequestHandler):
    timeout = 60  # s without a byte
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
        """Print no requests, so that the terminal keeps showing the address."""

    def send_head(self) -> Any:
        """Send the head of an answer; return what follows it."""
        self._bytes: int | None = None
        if self.headers.get("Host", HOST).split(":")[0].lower() not in _NAMES:
            return self.send_error(HTTPStatus.MISDIRECTED_REQUEST)
        path = self._served()
        if path is None:
            return self.send_error(HTTPStatus.NOT_FOUND)
        part = _RANGE.fullmatch(self.headers.get("Range", ""))
        size = path.stat().st_size
        first, last, final = map(int, part.groups("-1")) if part else (0, -1, -1)
        start = first if final < 0 else max(size - final, 0)
        stop = min(last + 1, size) if last >= 0 else size
        if not part or "If-Range" in self.headers or start >= stop or path.is_dir():
            return super().send_head()  # the whole file, as is allowed
        file = path.open("rb")
        file.seek(start)
        self._bytes = stop - start
        self.send_response(HTTPStatus.PARTIAL_CONTENT)
        self.send_header("Content-Type", self.guess_type(path))
        self.send_header("Content-Range", f"bytes {start}-{stop - 1}/{size}")
        self.send_header("Content-Length", str(self._bytes))
        self.end_headers()
        return file

    def _served(self) -> Path | None:
        """Requested file or folder, if it is in the served folder, links followed."""
        try:
            path = Path(self.translate_path(self.path))
            page = path / PAGE if path.is_dir() else path
            inside = page.resolve().is_relative_to(Path(self.directory).resolve())
            return path if inside and page.is_file() else None
        except (OSError, ValueError, RuntimeError):  # too long, a zero byte, a link to itself
            return None

    def copyfile(self, source: Any, outputfile: Any) -> None:
        """Send a file, or the requested part of it."""
        if self._bytes is None:
            super().copyfile(source, outputfile)
        while self._bytes and (chunk := source.read(min(self._bytes, 2**16))):
            outputfile.write(chunk)
            self._bytes -= len(chunk)


def server(folder: Path, port: int = 0) -> ThreadingHTTPServer:
    """A server of a report's folder, listening but not yet answering.

    Args:
        folder: made by `analysis.report`.
        port: 0 takes a free one.

    Raises:
        ServeError: the folder holds no report, or the port is not available.
    """
    if not (folder / PAGE).is_file():
        raise ServeError(
            f"{folder}: no {PAGE} there; make a report with `python -m analysis.report --out "
            f"{folder}`, or name its folder"
        )
    try:
        return _Server((HOST, port), partial(_Handler, directory=str(folder)))
    except (OSError, OverflowError) as error:
        raise ServeError(f"--port {port}: {error}; choose another, or 0 for a free one") from error


def address(of: ThreadingHTTPServer) -> str:
    """URL of a server's page."""
    return f"http://{HOST}:{of.server_address[1]}/"

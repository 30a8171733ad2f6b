"""A viewer to watch an episode while it runs: find one that answers, or open one.

What is sent to it is the recording's business (`cosim.recording.file`).
"""

import shutil
import socket
import sys
import time
from pathlib import Path
from urllib.parse import urlsplit

from cosim.base.errors import UserError, in_shell

DEFAULT_VIEWER = "rerun+http://127.0.0.1:9876/proxy"
ANSWER_TIMEOUT_S = 2.0
START_TIMEOUT_S = 20.0
_SCHEMES = ("rerun", "rerun+http", "rerun+https")
_DEFAULT_PORT = 9876


def find_viewer(url: str) -> str:
    """The address of a viewer, after it has answered."""
    host, port = _host(url)
    if not _answers(host, port):
        raise UserError(
            f"no Rerun viewer answers at {url}; start one with `{in_shell('rerun')}`, name its "
            "address with --viewer, or use --spawn"
        )
    return url


def spawn_viewer(url: str) -> str:
    """Open a viewer on this machine, or find the one that listens there; returns its address."""
    import rerun as rr  # noqa: PLC0415 - slow; commands read the default address from here

    host, port = _host(url)
    try:
        rr.spawn(
            port=port, connect=False, hide_welcome_screen=True, executable_path=viewer_executable()
        )
    except Exception as error:  # rerun raises RuntimeError whatever the cause
        raise UserError(f"the Rerun viewer does not start: {error}; use --live") from error
    began = time.monotonic()
    while not _answers(host, port):
        if time.monotonic() - began > START_TIMEOUT_S:
            raise UserError(
                f"the Rerun viewer does not answer at {url}; without a screen, start one "
                "elsewhere and use --live with --viewer"
            )
        time.sleep(0.1)
    return url


def viewer_executable() -> str | None:
    """Return the viewer installed with this Python, on the PATH or not; None if there is none."""
    return shutil.which("rerun", path=str(Path(sys.executable).parent))


def _host(url: str) -> tuple[str, int]:
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port or _DEFAULT_PORT
    except ValueError:
        host, port, parts = None, 0, urlsplit("")
    if parts.scheme not in _SCHEMES or host is None or parts.path != "/proxy":
        raise UserError(
            f"--viewer {url} is not the address of a viewer; write it as {DEFAULT_VIEWER}"
        )
    return host, port


def _answers(host: str, port: int) -> bool:
    try:
        socket.create_connection((host, port), timeout=ANSWER_TIMEOUT_S).close()
    except OSError:
        return False
    return True

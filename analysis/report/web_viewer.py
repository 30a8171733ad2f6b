"""The Rerun web viewer as files that a page can host, from the installed rerun-sdk.

The package carries them inside its program only, which serves them: they are fetched from it once
per version and kept in the cache. No other machine is asked.
"""

import socket
import subprocess
import time
import urllib.error
import urllib.request
from pathlib import Path

import rerun
import rerun_cli

from cosim.base.errors import UserError
from cosim.base.storage import cache_dir, is_intact, load_or_create, write_checksum, write_whole

FILES = ("re_viewer.js", "re_viewer_bg.wasm")
START_TIMEOUT_S = 30.0
_HOST = "127.0.0.1"


class WebViewerError(UserError):
    """The installed rerun-sdk does not give its web viewer away."""


def web_viewer_files() -> list[Path]:
    """Script and WebAssembly of the web viewer of the installed version.

    Raises:
        WebViewerError: rerun-sdk does not serve them.
    """
    folder = cache_dir("web_viewer") / rerun.__version__
    files = [folder / name for name in FILES]
    return load_or_create(
        folder,
        lambda: files if all(is_intact(file) for file in files) else None,
        lambda: _fetch(files),
    )


def _fetch(files: list[Path]) -> list[Path]:
    # The `rerun` command only starts this program, which would continue when the command is ended.
    program = Path(rerun_cli.__file__).with_name("rerun")
    port, grpc_port = _free_ports(2)
    command = [program, "--serve-web", "--bind", _HOST]
    command += ["--web-viewer-port", str(port), "--port", str(grpc_port)]
    try:
        viewer = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    except OSError as error:
        raise WebViewerError(f"{program}: {error.strerror}; install rerun-sdk again") from error
    try:
        for file in files:
            content = _download(f"http://{_HOST}:{port}/{file.name}", viewer)
            write_whole(file, content)
            write_checksum(file)
    finally:
        viewer.terminate()
        viewer.wait()
    return files


def _free_ports(count: int) -> list[int]:
    probes = [socket.create_server((_HOST, 0)) for _ in range(count)]
    ports = [probe.getsockname()[1] for probe in probes]
    for probe in probes:
        probe.close()
    return ports


def _download(url: str, viewer: subprocess.Popen[bytes]) -> bytes:
    """A file of the starting viewer; tries until it answers."""
    # A proxy set up for the outer network does not know this machine's own ports.
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    give_up = time.monotonic() + START_TIMEOUT_S
    while True:
        try:
            with opener.open(url, timeout=START_TIMEOUT_S) as answer:
                return answer.read()
        except (urllib.error.URLError, ConnectionError) as error:
            if viewer.poll() is not None or time.monotonic() > give_up:
                raise WebViewerError(
                    f"the web viewer of rerun-sdk {rerun.__version__} does not serve {url} "
                    f"({error}); install rerun-sdk again"
                ) from error
        time.sleep(0.1)

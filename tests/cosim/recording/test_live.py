"""Recordings sent to a running viewer: a real gRPC server receives what the file holds."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from cosim.base.errors import UserError
from cosim.base.progress import silent
from cosim.recording.blueprint import episode_blueprint
from cosim.recording.file import Recording, scalars, simulated
from cosim.recording.live import DEFAULT_VIEWER, find_viewer, spawn_viewer
from minirobots.commands.episodes import Run
from tests.alone import rrd, started

RERUN = Path(sys.executable).with_name("rerun")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def address(port: int) -> str:
    return f"rerun+http://127.0.0.1:{port}/proxy"


def rows_of(path: Path) -> dict[str, int]:
    """Rows per entity path of a recording, without its blueprint and properties."""
    rows: dict[str, int] = {}
    for chunk in RrdReader(str(path)).stream():
        if chunk.entity_path.startswith(("/sim", "/raw", "/rl", "/world", "/log", "/info")):
            rows[chunk.entity_path] = rows.get(chunk.entity_path, 0) + chunk.num_rows
    return rows


@pytest.fixture
def server(tmp_path):
    """A Rerun server that keeps what it receives: its address, its file, and how to end it."""
    port, received = free_port(), tmp_path / "received.rrd"
    process = subprocess.Popen(
        [RERUN, "--save", received, "--port", str(port)],
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # `rerun` starts another process: end both
    )

    def end(how: signal.Signals) -> None:
        if process.poll() is None:
            os.killpg(process.pid, how)
            if how != signal.SIGSTOP:
                process.wait(120.0)

    while True:
        try:
            find_viewer(address(port))
            break
        except UserError:
            assert process.poll() is None
            time.sleep(0.1)
    yield address(port), received, end
    end(signal.SIGKILL)


def send(recording: Recording, time_s: float) -> None:
    recording.columns("/sim/r1/heading", simulated(np.array([time_s])), scalars(np.array([0.5])))
    recording.flush()


@pytest.mark.long
def test_run_reaches_the_viewer_and_the_file(command, server, tmp_path):
    url, received, _ = server
    brief = ("--method", "paper", "--train-episodes", 20_000, "--time-limit", 4)
    done = command("run", *brief, "--out", tmp_path / "run", "--live", "--viewer", url)
    assert done.returncode == 0, done.stderr
    written = rows_of(tmp_path / "run" / "episodes" / "ep_000.rrd")
    assert written["/sim/r1/motors/omega"] == 801  # and the row of its style
    deadline = time.monotonic() + 120.0
    saved = {}
    while saved != written:  # the server saves what it has received in its own time
        assert time.monotonic() < deadline
        time.sleep(0.1)
        with contextlib.suppress(RuntimeError, ValueError):  # the last message is half written
            saved = rows_of(received)


def test_lost_viewer_does_not_lose_the_file(server, tmp_path, capfd):
    url, _, end = server
    path = tmp_path / "episode.rrd"
    with Recording(path, "test", episode_blueprint(1, (0.3, 0.3)), url) as recording:
        send(recording, 1.0)
        end(signal.SIGKILL)
        deadline = time.monotonic() + 120.0
        count = 1
        while "is gone" not in capfd.readouterr().err:
            assert time.monotonic() < deadline
            count += 1
            send(recording, float(count))
            time.sleep(0.05)
        send(recording, 1000.0)
    assert rows_of(path) == {"/sim/r1/heading": count + 1}
    assert rrd("verify", path)


FROZEN = """
import sys
from pathlib import Path
import numpy as np
from cosim.recording import file as recording
from cosim.recording.blueprint import episode_blueprint
from cosim.base.errors import run_command

def main():
    recording.FLUSH_TIMEOUT_S = 5.0
    path, url = Path(sys.argv[1]), sys.argv[2]
    with recording.Recording(path, "test", episode_blueprint(1, (0.3, 0.3)), url) as file:
        while True:
            times = recording.simulated(np.arange(20_000.0))
            values = np.random.default_rng(0).normal(size=(20_000, 6))
            file.columns("/sim/r1/heading", times, recording.scalars(values))
            file.flush()
            print("sent", flush=True)

run_command(main)
"""


@pytest.mark.slow
def test_frozen_viewer_does_not_hold_the_command_up(server, tmp_path):
    url, _, end = server
    path = tmp_path / "episode.rrd"
    writer, said = started("-c", FROZEN, path, url)
    with writer:
        assert said == "sent\n"
        end(signal.SIGSTOP)
        try:
            _, errors = writer.communicate(timeout=300.0)
        finally:
            writer.kill()
    assert writer.returncode == 2
    assert errors.startswith(f"error: the viewer at {url} does not accept recorded data")
    assert [file.name for file in tmp_path.glob("episode*")] == ["episode.rrd.part"]


@pytest.mark.parametrize("how", [find_viewer, spawn_viewer])
@pytest.mark.parametrize("url", ["127.0.0.1:9876", "http://127.0.0.1/proxy", "rerun+http://x"])
def test_address_that_is_none_is_named(how, url):
    with pytest.raises(UserError, match=DEFAULT_VIEWER.replace("+", r"\+")):
        how(url)


def test_a_viewer_is_opened_at_its_address(server, monkeypatch):
    url, asked = server[0], {}
    monkeypatch.setattr("rerun.spawn", lambda **how: asked.update(how))  # there is no screen
    assert spawn_viewer(url) == url
    assert f":{asked['port']}/" in url


def test_missing_viewer_is_told_before_anything_is_done(tmp_path):
    url = address(free_port())
    with pytest.raises(UserError, match="no Rerun viewer answers at"):
        Run(live=True, viewer=url, out=tmp_path / "x").run(silent)
    assert not (tmp_path / "x").exists()

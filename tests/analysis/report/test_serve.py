"""The report's server: this machine only, types that browsers insist on, a clean end."""

import signal
import subprocess
import sys
import threading
import urllib.request

import pytest

from analysis.report.server import HOST, ServeError, address, server


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "index.html").write_text("<p>report</p>")
    (tmp_path / "viewer.wasm").write_bytes(b"\0asm")
    (tmp_path / "viewer.js").write_text("1")
    (tmp_path / "ep.rrd").write_bytes(b"RRF2")
    return tmp_path


def test_files_come_with_their_types(folder):
    with server(folder) as serving:
        thread = threading.Thread(target=serving.serve_forever)
        thread.start()
        try:
            types = {}
            for name in ("", "viewer.wasm", "viewer.js", "ep.rrd"):
                with urllib.request.urlopen(address(serving) + name) as answer:
                    types[name] = answer.headers["Content-Type"]
        finally:
            serving.shutdown()
            thread.join()
    assert types == {
        "": "text/html",
        "viewer.wasm": "application/wasm",
        "viewer.js": "text/javascript",
        "ep.rrd": "application/octet-stream",
    }


def test_only_this_machine_is_served(folder):
    with server(folder) as serving:
        assert serving.server_address[0] == HOST == "127.0.0.1"


def test_refusals_name_the_thing_and_the_mend(folder, tmp_path):
    with pytest.raises(ServeError, match=r"no index\.html there; make a report with"):
        server(tmp_path / "nothing")
    with server(folder) as serving:
        port = serving.server_address[1]
        with pytest.raises(ServeError, match=rf"--port {port}: .*choose another, or 0"):
            server(folder, port)
    with pytest.raises(ServeError, match="--port 70000"):
        server(folder, 70000)


def test_ctrl_c_is_the_intended_end(folder):
    command = [sys.executable, "-m", "analysis.serve", str(folder), "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as serving:
        assert serving.stdout is not None
        said = serving.stdout.readline()
        assert said.startswith(b"report: http://127.0.0.1:")
        serving.send_signal(signal.SIGINT)
        _, errors = serving.communicate(timeout=300)
    assert (serving.returncode, errors) == (0, b"")

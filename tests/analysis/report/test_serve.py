"""The report's server: this machine only, types that browsers insist on, a clean end."""

import os
import signal
import socket
import subprocess
import sys
import threading
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from http.client import HTTPConnection

import pytest

from analysis.report.server import HOST, ServeError, address, server


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "index.html").write_text("<p>report</p>")
    (tmp_path / "viewer.wasm").write_bytes(b"\0asm")
    (tmp_path / "viewer.js").write_text("1")
    (tmp_path / "ep.rrd").write_bytes(b"RRF2")
    return tmp_path


@pytest.fixture
def serving(folder):
    """The server of the folder while it answers."""
    with server(folder) as running:
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        yield running
        running.shutdown()
        thread.join()


def test_files_come_with_their_types(serving):
    types = {}
    for name in ("", "viewer.wasm", "viewer.js", "ep.rrd"):
        with urllib.request.urlopen(address(serving) + name) as answer:
            types[name] = answer.headers["Content-Type"]
    assert types == {
        "": "text/html",
        "viewer.wasm": "application/wasm",
        "viewer.js": "text/javascript",
        "ep.rrd": "application/octet-stream",
    }


def ask(serving, path, method="GET", **headers):
    """Status, headers and content of an answer."""
    connection = HTTPConnection(*serving.server_address[:2], timeout=60)
    connection.request(method, path, headers={k.replace("_", "-"): v for k, v in headers.items()})
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, answer.headers, content


def test_two_hundred_requests_at_once_succeed(serving):
    ready = threading.Barrier(200)

    def request(_):
        ready.wait()
        return ask(serving, "/ep.rrd")[::2]

    with ThreadPoolExecutor(200) as pool:
        assert set(pool.map(request, range(200))) == {(200, b"RRF2")}


@pytest.mark.long
@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("127.0.0.1:80", 200),
        ("LocalHost", 200),
        ("evil.org", 421),
        ("127.0.0.1.evil.org:8000", 421),
    ],
)
def test_names_of_other_hosts_are_refused(serving, host, status):
    """A page of a foreign site, whose name was bound to this machine, reads nothing."""
    assert ask(serving, "/index.html", Host=host)[0] == status


@pytest.mark.long
@pytest.mark.parametrize(
    ("asked", "status", "content", "said"),
    [
        ("bytes=1-2", 206, b"RF", "bytes 1-2/4"),
        ("bytes=2-", 206, b"F2", "bytes 2-3/4"),
        ("bytes=-1", 206, b"2", "bytes 3-3/4"),
        ("bytes=-9", 206, b"RRF2", "bytes 0-3/4"),
        ("bytes=0-99", 206, b"RRF2", "bytes 0-3/4"),
        ("bytes=4-", 200, b"RRF2", None),  # nothing of it is there: the whole file is allowed
        ("bytes=-0", 200, b"RRF2", None),
        ("bytes=3-2", 200, b"RRF2", None),
        ("bytes=0-0,2-3", 200, b"RRF2", None),
        ("lines=1-2", 200, b"RRF2", None),
        (f"bytes={'9' * 5000}-", 200, b"RRF2", None),
    ],
)
def test_parts_of_files(serving, asked, status, content, said):
    answer = ask(serving, "/ep.rrd", Range=asked)
    assert (answer[0], answer[2]) == (status, content)
    assert answer[1]["Content-Range"] == said
    assert answer[1]["Content-Length"] == str(len(content))


def test_nothing_but_files_of_the_folder_is_served(serving, folder, tmp_path_factory):
    outside = tmp_path_factory.mktemp("outside")
    (outside / "index.html").write_text("secret")
    for name, target in (("file", outside / "index.html"), ("folder", outside), ("loop", "loop")):
        (folder / name).symlink_to(target)
    (folder / "mine").symlink_to("ep.rrd")
    (folder / "empty").mkdir()
    (folder / "page").mkdir()
    (folder / "page" / "index.html").symlink_to(outside / "index.html")
    os.mkfifo(folder / "pipe")
    paths = ("/file", "/folder/", "/folder/index.html", "/loop", "/empty/", "/page/", "/pipe",
             "/%00", "/a%00b", "/%ff%fe", "/" + "a" * 300, "/nothing",
             "/../../etc/passwd")  # fmt: skip
    answers = {path: ask(serving, path) for path in paths}
    assert {path: status for path, (status, _, _) in answers.items() if status != 404} == {}
    assert not [path for path, answer in answers.items() if b"secret" in answer[2]]
    assert ask(serving, "/mine")[::2] == (200, b"RRF2")


def test_clients_that_leave_print_nothing(serving, folder, capfd):
    (folder / "large.rrd").write_bytes(bytes(2**24))
    for request in (b"GET /large.rrd HTTP/1.1\r\nHost: localhost\r\n\r\n", b"GET /large", b""):
        client = socket.create_connection(serving.server_address[:2])
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")  # a reset
        client.sendall(request)
        if request.endswith(b"\n"):
            client.recv(1)
        client.close()
    assert ask(serving, "/ep.rrd")[0] == 200
    while [t for t in threading.enumerate() if "process_request" in t.name]:
        pass  # of the server, one for each client
    assert capfd.readouterr() == ("", "")


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

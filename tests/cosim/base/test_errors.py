"""What reaches the terminal: no traceback of an interrupt, names as they are."""

import contextlib
import io
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base import errors
from cosim.base.errors import run_command
from cosim.base.table import Column, markdown, show_texts
from tests.alone import python, started

ROOT = Path(__file__).parents[3]
# Imports that take long: a package that many modules import, which does not end.
SLOW = "print('importing', flush=True)\nwhile True: pass\n"
COMMANDS = {
    "cosim": ["-m", "cosim.run"],
    "analysis": ["-m", "analysis.reproduce"],
    "sub-command": ["-m", "minirobots", "run"],
    "script": ["-c", "import sys; from minirobots.__main__ import main; sys.exit(main())", "run"],
}


@pytest.mark.long
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("name", COMMANDS)
def test_an_interrupt_during_imports_ends_quietly(tmp_path, name, how):
    (tmp_path / "tyro.py").write_text(SLOW)
    env = os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    process, said = started(*COMMANDS[name], cwd=tmp_path, env=env)
    assert said == "importing\n"
    process.send_signal(how)
    _, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (-how, "")  # a shell says 130, 143


@pytest.mark.parametrize(
    "program",
    ["import cosim", "import sys; sys.argv = ['-m']; import cosim", "import agent, analysis, fmus"],
)
def test_programs_keep_their_interrupts(program):
    said = "import signal; print(signal.getsignal(2) is signal.default_int_handler)"
    assert python("-c", f"{program}; {said}", check=True).stdout == "True\n"


def test_an_ignored_interrupt_stays_ignored():
    """As of a command that a shell without job control runs in the background."""
    script = 'trap \'\' INT; exec "$0" -c "$1"'
    program = (
        "import signal; from cosim.base.errors import end_at_interrupt, run_command;"
        "end_at_interrupt(); run_command(lambda: print(signal.getsignal(signal.SIGINT).name))"
    )
    command = ["sh", "-c", script, sys.executable, program]
    assert subprocess.run(command, capture_output=True, check=True).stdout == b"SIG_IGN\n"


def ended(main, capsys):
    status = 0
    try:
        run_command(main)
    except SystemExit as end:
        status = end.code
    return status, capsys.readouterr()


@pytest.fixture
def handlers():
    """Put handlers of signals back."""
    usual = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in usual.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("handlers")
@pytest.mark.parametrize(("how", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signals_that_come_together_do_not_disturb_the_end(capsys, how, status):
    """As `timeout` sends them, to a process and to its group."""
    done = []

    def main():
        try:
            signal.raise_signal(how)
        finally:
            signal.raise_signal(signal.SIGTERM)
            signal.raise_signal(how)
            done.append("whole")

    found, said = ended(main, capsys)
    assert (found, done, said.err) == (status, ["whole"], "interrupted\n")
    signal.raise_signal(signal.SIGTERM)  # while the interpreter ends


@pytest.mark.usefixtures("handlers")
def test_ctrl_c_ends_what_takes_too_long_to_end(capsys, monkeypatch):
    monkeypatch.setattr(errors, "_BURST_S", 0.0)
    reached = []

    def main():
        try:
            signal.raise_signal(signal.SIGTERM)
        finally:
            reached.append("end")
            signal.raise_signal(signal.SIGINT)
            reached.append("end of it")

    status, _ = ended(main, capsys)
    assert (status, reached) == (130, ["end"])


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&-", "<&- >&- 2>&-"])
def test_closed_streams_are_no_error(tmp_path, closed):
    """Nor does a file get their number, in which all that is printed would go."""
    script = (
        "import sys; from pathlib import Path; from cosim.base.errors import run_command\n"
        "from cosim.base.table import show_texts\n"
        "def main():\n"
        "    print('said'); print('said', file=sys.stderr); show_texts(['a'], [['b']])\n"
        "    with Path('file').open('w') as file: file.write(str(file.fileno()))\n"
        "run_command(main)"
    )
    command = ["sh", "-c", f'exec "$0" -c "$1" {closed}', sys.executable, script]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (run.returncode, run.stderr) == (0, "" if "2" in closed else "said\n")
    assert int((tmp_path / "file").read_text()) > 2


def test_an_output_that_cannot_be_written_is_named():
    command = ["sh", "-c", 'exec "$0" -m minirobots methods 1</dev/null', sys.executable]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 2
    assert re.fullmatch("error: the output is not open for writing; .*\n", run.stderr)


@given(st.text("[]/\\\\:|ab#_*red bold", max_size=20).filter(str.strip), st.integers(1, 2))
def test_tables_show_names_as_they_are(name, names):
    text, plain = io.StringIO(), "".join(name.split())
    rows = [[name, "1"], ["p[a]/policy.npz", "2"], [":bug:", "[/]"]]
    with contextlib.redirect_stdout(text):
        show_texts([name, "[b]"], rows, title=name, names=names)
    shown = "".join(text.getvalue().split())
    assert shown.count(plain) >= 3
    assert all(text in shown for text in ("p[a]/policy.npz", ":bug:", "[/]", "[b]"))
    header, _, row = markdown([Column(name, str)], [name]).splitlines()
    assert len(re.findall(r"(?<!\\)\|", header)) == len(re.findall(r"(?<!\\)\|", row)) == 2

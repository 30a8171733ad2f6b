"""What reaches the terminal: no traceback of an interrupt, no names that control it."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.base.errors import UserError, run_command, visible
from cosim.base.table import show_texts
from tests.alone import python, started

ROOT = Path(__file__).parents[3]
NAME = "a\x1b]0;title\x07\x1b[2J\u202eb\u2066\x9b\r\udcffä\n"
SHOWN = r"a\u001b]0;title\u0007\u001b[2J\u202eb\u2066\u009b\u000d\udcffä" + "\n"
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


def test_names_cannot_control_a_terminal(capsys):
    assert visible(NAME) == SHOWN

    def refuse():
        raise UserError(NAME + "\x1b[31m")

    status, said = ended(refuse, capsys)
    assert (status, said.err) == (2, rf"error: {SHOWN}\u001b[31m" + "\n")

    def fail():
        raise FileNotFoundError(2, "no", NAME)

    status, said = ended(fail, capsys)
    assert (status, said.err.startswith(f"error: {SHOWN}: ")) == (2, True)

    def show():
        print(NAME)
        print(NAME, file=sys.stderr)
        show_texts(("name",), [(NAME.strip(),)])

    status, said = ended(show, capsys)
    assert (status, said.err) == (0, SHOWN + "\n")
    assert said.out.startswith(SHOWN)
    assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]", said.out)


def test_json_stays_what_it_was(capsys):
    """Escapes are those of JSON."""
    _, said = ended(lambda: print('{"a": "\u202e\x9f"}'), capsys)
    assert said.out == '{"a": "\\u202e\\u009f"}\n'

"""Whatever stands on a command line, it is taken or refused with status 2, without traceback."""

import contextlib
import io
import re
import sys
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.simulation.options import Physics
from minirobots import runner
from minirobots.__main__ import main, purposes
from tests.faults.fuzzing import examples

COMMANDS = sorted(purposes())
WORDS = st.one_of(
    st.sampled_from(
        ("0", "1", "2", "-1", "nan", "inf", "-inf", "1e-320", "1e300", "1e9", "9" * 30, "0.05",
         "", "x", "1a", "all", "none", "True", "None", "--", "-", "/dev/null", "/proc/none/a.toml",
         "none.toml", "none.npz", "µ", "\udcff", "a\nb", "paper", "moves", "motors", "2e-05")
    ),
    st.text(max_size=4),
)  # fmt: skip


class TakenError(Exception):
    """The options were taken: what they ask for is not done here."""


@pytest.fixture(scope="module")
def flags():
    """Every command's options, as its help names them."""
    found = {}
    for name in COMMANDS:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "argv", ["minirobots", name, "--help"])
            with contextlib.redirect_stdout(io.StringIO()) as text, pytest.raises(SystemExit):
                main()
        found[name] = sorted(set(re.findall(r"--[a-z][a-z0-9.-]+", text.getvalue())))
    return found


def ended(name: str, arguments: list[str]) -> tuple[int, str]:
    """Status and stderr of a command that stops when its options are taken."""
    parse = runner.parse

    def stop(*given_: Any) -> None:
        options = parse(*given_)
        physics = getattr(options, "physics", options)
        if isinstance(physics, Physics):
            physics.config()
        raise TakenError

    out, err = io.StringIO(), io.StringIO()
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        patch.setattr(runner, "parse", stop)
        patch.setattr(sys, "argv", ["minirobots", name, *arguments])
        try:
            main()
        except TakenError:
            return 0, ""
        except SystemExit as end:
            return int(end.code or 0), out.getvalue() + err.getvalue()
    raise AssertionError(f"{name} {arguments} did nothing")


@pytest.mark.long
@examples(80)
@given(data=st.data())
def test_any_command_line(flags, data):
    name = data.draw(st.sampled_from(COMMANDS))
    names = st.sampled_from(flags[name])
    option = st.one_of(
        st.tuples(names, WORDS), st.tuples(names, WORDS), st.tuples(names), st.tuples(WORDS)
    )
    arguments = [word for some in data.draw(st.lists(option, max_size=4)) for word in some]
    status, said = ended(name, arguments)
    assert status in {0, 2}, said
    assert "Traceback" not in said
    assert said or status == 0

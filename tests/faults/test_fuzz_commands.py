"""Whatever stands on a command line, it is taken or refused with status 2, without traceback."""

import contextlib
import io
import re
import sys
from importlib import import_module

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.__main__ import COMMANDS
from cosim.base.errors import run_command
from cosim.navigation.options import Physics
from tests.faults.fuzzing import examples

MODULES = sorted(command.module for command in COMMANDS.values())
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
    for module in MODULES:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "argv", [module, "--help"])
            with contextlib.redirect_stdout(io.StringIO()) as text, pytest.raises(SystemExit):
                import_module(module).main()
        found[module] = sorted(set(re.findall(r"--[a-z][a-z0-9.-]+", text.getvalue())))
    return found


def ended(module: str, arguments: list[str]) -> tuple[int, str]:
    """Status and stderr of a command that stops when its options are taken."""
    command = import_module(module)
    parse = command.parse

    def stop(*given_: object) -> None:
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
        patch.setattr(command, "parse", stop)
        patch.setattr(sys, "argv", [module, *arguments])
        try:
            run_command(command.main)
        except TakenError:
            return 0, ""
        except SystemExit as end:
            return int(end.code or 0), out.getvalue() + err.getvalue()
    raise AssertionError(f"{module} {arguments} did nothing")


@examples(80)
@given(data=st.data())
def test_any_command_line(flags, data):
    module = data.draw(st.sampled_from(MODULES))
    names = st.sampled_from(flags[module])
    option = st.one_of(
        st.tuples(names, WORDS), st.tuples(names, WORDS), st.tuples(names), st.tuples(WORDS)
    )
    arguments = [word for some in data.draw(st.lists(option, max_size=4)) for word in some]
    status, said = ended(module, arguments)
    assert status in {0, 2}, said
    assert "Traceback" not in said
    assert said or status == 0

"""Whatever stands on a command line, it is taken or refused with status 2, without traceback."""

import contextlib
import io
import re
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import run_command
from cosim.simulation.options import Physics
from minirobots.commands import COMMANDS, class_of
from minirobots.runner import parse
from tests.faults.fuzzing import examples

WORDS = st.one_of(
    st.sampled_from(
        ("0", "1", "2", "-1", "nan", "inf", "-inf", "1e-320", "1e300", "1e9", "9" * 30, "0.05",
         "", "x", "1a", "all", "none", "True", "None", "--", "-", "/dev/null", "/proc/none/a.toml",
         "none.toml", "none.npz", "µ", "\udcff", "a\nb", "paper", "moves", "motors", "2e-05")
    ),
    st.text(max_size=4),
)  # fmt: skip


def ended(name: str, arguments: list[str]) -> tuple[int, str]:
    """Status and output of a command that does nothing once its options are taken."""

    def main() -> None:
        kind = class_of(name)
        options: Any = parse(kind, name, arguments, kind.defaults(arguments)).options
        physics = getattr(options, "physics", options)
        if isinstance(physics, Physics):
            physics.config()

    text = io.StringIO()
    with contextlib.redirect_stdout(text), contextlib.redirect_stderr(text):
        try:
            run_command(main)
        except SystemExit as end:
            return int(end.code or 0), text.getvalue()
    return 0, ""


@pytest.fixture(scope="module")
def flags():
    """Every command's options, as its help names them."""
    pattern = re.compile(r"--[a-z][a-z0-9.-]+")
    return {name: sorted({*pattern.findall(ended(name, ["--help"])[1])}) for name in COMMANDS}


@pytest.mark.long
@examples(80)
@given(data=st.data())
def test_any_command_line(flags, data):
    name = data.draw(st.sampled_from(sorted(COMMANDS)))
    names = st.sampled_from(flags[name])
    option = st.one_of(
        st.tuples(names, WORDS), st.tuples(names, WORDS), st.tuples(names), st.tuples(WORDS)
    )
    arguments = [word for some in data.draw(st.lists(option, max_size=4)) for word in some]
    status, said = ended(name, arguments)
    assert status in {0, 2}, said
    assert "Traceback" not in said
    assert said or status == 0

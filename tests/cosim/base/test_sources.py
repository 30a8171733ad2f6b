"""The code that a result depends on: what imports lead to, and what counts as a change of it."""

import ast
from pathlib import Path

import pytest

from cosim.base.provenance import (
    OWN,
    ROOT,
    code_digest,
    imported_files,
    with_imports,
)

FILES = sorted(file for package in OWN for file in (ROOT / package).rglob("*.py"))


def test_imports_are_followed():
    files = with_imports([ROOT / "cosim" / "navigation" / "batch.py"])
    names = {file.name for file in files}
    assert {"episode.py", "master.py", "params.py", "errors.py"} <= names
    assert not {"run.py", "file.py", "policy.py"} & names
    assert ROOT / "cosim" / "coupling" / "master.py" in imported_files(
        ROOT / "cosim" / "navigation" / "batch.py"
    )


def test_a_file_can_be_left_out_with_what_only_it_imports():
    simulation = ROOT / "cosim" / "simulation.py"
    recording = ROOT / "cosim" / "recording" / "episode.py"
    reading = ROOT / "cosim" / "reading" / "episode.py"
    without = with_imports([simulation], but=[recording, reading])
    left = set(with_imports([simulation])) - set(without)
    assert {recording, ROOT / "cosim" / "recording" / "blueprint.py"} <= left
    assert ROOT / "cosim" / "navigation" / "episode.py" not in left


def imported_by_syntax(path: Path) -> set[Path]:
    """The same as `imported_files`, from the syntax tree."""
    found: set[Path] = set()
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            parts = name.split(".")
            if parts[0] in OWN:
                places = [ROOT.joinpath(*parts), ROOT.joinpath(*parts[:-1])]
                files = [f for p in places for f in (p.with_suffix(".py"), p / "__init__.py")]
                found.add(next(file for file in files if file.is_file()))
    return found


def test_imports_are_those_of_the_syntax_tree():
    # an example in a module's docstring may import the module
    assert {f: imported_files(f) - {f} for f in FILES} == {f: imported_by_syntax(f) for f in FILES}


@pytest.mark.parametrize(
    ("statement", "modules"),
    [
        ("import cosim.base.params", {"cosim/base/params.py"}),
        (
            "import numpy, cosim.base.params as p, agent.process.grid",
            {"cosim/base/params.py", "agent/process/grid.py"},
        ),
        ("from cosim.base import params", {"cosim/base/params.py"}),
        (
            "from cosim.base import (\n    params as p,  # :-)\n    jit,\n)",
            {"cosim/base/params.py", "cosim/base/jit.py"},
        ),
        (
            "from cosim.base import params, \\\n    jit",
            {"cosim/base/params.py", "cosim/base/jit.py"},
        ),
        (
            "def f():\n    from cosim.base.params import (\n        TABLE_I,\n    )",
            {"cosim/base/params.py"},
        ),
        ("from cosim import nothing", {"cosim/__init__.py"}),
        ("from . import near, nearer", {"inner/near.py", "inner/nearer.py"}),
        ("from .near import x", {"inner/near.py"}),
        ("from .. import far", {"far.py"}),
        ("from ..far import (x)", {"far.py"}),
        ("x = 'from cosim.base import params'", set()),
        ("# import cosim.base.params", set()),
    ],
)
def test_every_form_of_import_is_seen(statement, modules, tmp_path):
    (tmp_path / "inner").mkdir()
    for name in ("inner/near.py", "inner/nearer.py", "far.py"):
        (tmp_path / name).touch()
    path = tmp_path / "inner" / "module.py"
    path.write_text(f"{statement}\n")
    places = {(ROOT if name[:5] in ("cosim", "agent") else tmp_path) / name for name in modules}
    assert imported_files(path) == places


def test_code_is_the_same_with_other_comments_and_layout(tmp_path):
    file = tmp_path / "a.py"
    file.write_text('"""A."""\n\n\ndef f(x):\n    """Add."""\n    return x + 1\n')
    first = code_digest([file])
    file.write_text('"""B."""\ndef f(x):\n    """Increase."""\n    # why\n    return (x + 1)\n')
    assert code_digest([file]) == first
    file.write_text("def f(x):\n    return x + 2\n")
    assert code_digest([file]) != first

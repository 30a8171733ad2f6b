"""`minirobots`: every command behind its name, help that comes at once, and refusals."""

import json
import subprocess
import sys
from dataclasses import is_dataclass
from importlib import import_module

import pytest

import cosim.__main__
from cosim.__main__ import COMMANDS

# What takes long to load, and no options need.
HEAVY = {
    "cma", "fmpy", "gymnasium", "joblib", "matplotlib", "numba", "pyarrow", "rerun", "rich",
    "scipy",
}  # fmt: skip
# Prints, by command, the start of its help and what it has loaded so far.
HELP_OF_ALL = """
import contextlib, io, json, sys
from importlib import import_module
found = {}
for name, module in json.loads(sys.argv[1]).items():
    sys.argv = [f"minirobots {name}", "--help"]
    with contextlib.redirect_stdout(io.StringIO()) as text, contextlib.suppress(SystemExit):
        import_module(module).main()
    loaded = {module.partition(".")[0] for module in sys.modules}
    found[name] = text.getvalue().splitlines()[0], sorted(loaded)
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def minirobots(command):
    return lambda *arguments: command(cosim.__main__, *arguments)


@pytest.mark.parametrize("name", COMMANDS)
def test_command_has_its_module_and_options(name):
    module = import_module(COMMANDS[name].module)
    options = getattr(module, COMMANDS[name].options)
    assert callable(module.main)
    assert is_dataclass(options)
    assert options.__doc__


def test_help_of_each_command_loads_only_what_options_need():
    modules = {name: command.module for name, command in COMMANDS.items()}
    arguments = [sys.executable, "-c", HELP_OF_ALL, json.dumps(modules)]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found.keys() == modules.keys()
    for name, (first, loaded) in found.items():
        assert first.startswith(f"usage: minirobots {name} "), first
        assert not HEAVY.intersection(loaded), name


@pytest.mark.parametrize("arguments", [(), ("--help",), ("-h",)])
def test_help_names_every_command(minirobots, arguments):
    done = minirobots(*arguments)
    assert (done.returncode, done.stderr) == (0, "")
    for name, known in COMMANDS.items():
        assert f"  {name} " in done.stdout
        assert known.purpose in done.stdout


def test_command_does_what_its_module_does(minirobots, tmp_path):
    done = minirobots("run", "--scenario", "7", "--out", tmp_path / "x")
    assert done.returncode == 2
    assert done.stderr.startswith("error: unknown scenario '7'")
    assert not (tmp_path / "x").exists()


def test_unknown_command_gets_one_sentence(minirobots):
    done = minirobots("fly", "--help")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("error: minirobots has no command fly; choose one of run, train,")
    assert done.stderr.count("\n") == 1


def test_completion_for_bash_knows_every_command_and_its_options(minirobots):
    done = minirobots("--tyro-print-completion", "bash")
    assert done.returncode == 0, done.stderr
    script = done.stdout
    assert "complete" in script
    assert [name for name in COMMANDS if name not in script] == []
    assert "--shield" in script
    syntax = subprocess.run(
        ["bash", "-n"], input=script, capture_output=True, text=True, check=False
    )
    assert (syntax.returncode, syntax.stderr) == (0, "")

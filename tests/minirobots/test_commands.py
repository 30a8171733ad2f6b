"""`minirobots`: every command behind its name, help that comes at once, and refusals."""

import json
import os
import re
import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import agent
import minirobots.__main__
from agent.moves.worlds import WorldRange
from agent.study import store
from cosim.base.errors import UserError
from cosim.base.jobs import Workers
from minirobots.commands import COMMANDS
from minirobots.commands.episodes import Run, Web
from minirobots.runner import parse, print_json
from tests.alone import python

ROOT = Path(__file__).parents[2]
# What takes long to load, and no options need.
HEAVY = {
    "fmpy", "gymnasium", "joblib", "matplotlib", "numba", "pyarrow", "rerun", "rich",
    "scipy",
}  # fmt: skip
# Prints, by command, the start of its help and what it has loaded so far.
HELP_OF_ALL = """
import contextlib, io, json, sys
from minirobots.__main__ import main
found = {}
for name in json.loads(sys.argv[1]):
    sys.argv = ["minirobots", name, "--help"]
    with contextlib.redirect_stdout(io.StringIO()) as text, contextlib.suppress(SystemExit):
        main()
    loaded = {module.partition(".")[0] for module in sys.modules}
    found[name] = text.getvalue().splitlines()[0], sorted(loaded)
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def program(command):
    return lambda *arguments: command(minirobots.__main__, *arguments)


def test_help_of_each_command_loads_only_what_options_need():
    done = python("-c", HELP_OF_ALL, json.dumps(list(COMMANDS)))
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found.keys() == COMMANDS.keys()
    for name, (first, loaded) in found.items():
        assert first.startswith(f"usage: minirobots {name} "), first
        assert not HEAVY.intersection(loaded), name


@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
def test_terminals_of_any_encoding_show_what_they_can(encoding):
    environment = os.environ | {"PYTHONIOENCODING": encoding}
    done = python("-m", "minirobots", "run", "--help", env=environment, text=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert "with a ? of 0.4" in " ".join(done.stdout.decode(encoding).split())


def test_json_is_ascii(capsys):
    print_json({"µ": "±5 %\n🤖"})
    out = capsys.readouterr().out
    assert out.isascii()
    assert json.loads(out) == {"µ": "±5 %\n🤖"}


def test_help_names_every_command_and_loads_none():
    program = "import sys, minirobots.__main__ as m; m.main(); print(*sys.modules, file=sys.stderr)"
    for arguments in ((), ("--help",), ("-h",)):
        done = python("-c", program, *arguments)
        assert not {"tyro", "numpy"}.intersection(done.stderr.split())
        for name, (*_, purpose) in COMMANDS.items():
            assert re.search(f"  {name} +{re.escape(purpose)}\n", done.stdout)


@pytest.mark.parametrize(
    "arguments",
    [
        "export FILE --to csv --out", "export FILE --to parquet --out", "identify-robot --excite",
        "motor-test --out", "moves --out", "platform --out", "screenshot FILE --out",
    ],
)  # fmt: skip
def test_results_replace_no_file_of_another_kind(program, tmp_path, arguments):
    kept = tmp_path / ("a.csv" if "motor-test" in arguments else "a.rrd")
    kept.write_text("kept")
    done = program(*arguments.replace("FILE", str(kept)).split(), kept)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert kept.name in done.stderr
    assert kept.read_text() == "kept"


def test_unknown_options_name_the_command_that_has_them(capsys):
    with pytest.raises(SystemExit):
        parse(Run, "minirobots run", ["--learning.gamma", "0.9"])
    said = capsys.readouterr().err
    assert "--learning.gamma FLOAT" in said
    assert "in minirobots train --help" in said


@pytest.mark.parametrize("kind", [Run, Web])
def test_a_policy_is_named_first_or_as_an_option(kind):
    for arguments in (["a.npz"], ["--policy", "a.npz"], ["a.npz", "--policy", "a.npz"]):
        assert parse(kind, "", arguments).options.policy == Path("a.npz")
    with pytest.raises(UserError, match="name one policy"):
        parse(kind, "", ["a.npz", "--policy", "b.npz"])


def test_help_ends_with_examples_of_the_page_and_unknown_commands_have_none(program):
    refused = program("fly", "--help")
    assert (refused.returncode, refused.stdout, refused.stderr.count("\n")) == (2, "", 1)
    assert refused.stderr.startswith("error: minirobots has no command fly; choose one of ")
    done = program("evaluate", "--help")
    assert done.returncode == 0
    assert "\nexamples:\n  minirobots evaluate " in done.stdout
    assert "P.npz --claim" in done.stdout


@pytest.mark.long
def test_completion_for_bash_knows_every_command_and_its_options(program):
    done = program("--tyro-print-completion", "bash")
    assert done.returncode == 0, done.stderr
    assert "complete" in done.stdout
    assert [name for name in (*COMMANDS, "--shield") if name not in done.stdout] == []
    subprocess.run(["bash", "-n"], input=done.stdout, text=True, check=True)


@pytest.fixture
def added(tmp_path):
    """Returns `minirobots` with a command of CONTRIBUTING.md, by its class: a file and a line."""

    def add(kind: str, name: str):
        page = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
        (code,) = re.findall(
            rf"^```python\n((?:(?!```).)*class {kind}\(.*?)^```$", page, re.M | re.S
        )
        (line,) = re.findall(rf'^ *("{name}": .*)$', page, re.M)
        shutil.copytree(ROOT / "minirobots", tmp_path / "minirobots")
        commands = tmp_path / "minirobots" / "commands"
        (commands / "mine.py").write_text(code)
        table = (commands / "__init__.py").read_text("utf-8")
        (commands / "__init__.py").write_text(table.replace("COMMANDS = {", "COMMANDS = {" + line))
        environment = os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
        return lambda *arguments: python(
            "-m", "minirobots", *arguments, cwd=tmp_path, env=environment
        )

    return add


@pytest.mark.long
def test_a_study_is_added_by_one_file(added, tmp_path):
    called = added("Decisions", "decisions")
    small = ("--steps", "1.0", "4.0", "--episodes", "1", "--jobs", "1", "--json")
    done = called("decisions", *small)
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout.splitlines()[-1])["rows"]
    assert [(row["policy"], row["rl_step"], row["episodes"]) for row in rows] == [
        ("shortest", 1.0, 1), ("shortest", 4.0, 1), ("fastest", 1.0, 1), ("fastest", 4.0, 1)
    ]  # fmt: skip
    assert (tmp_path / "runs" / "decisions" / "study.png").exists()


@pytest.mark.long
def test_a_command_is_added_by_one_file(added):
    called = added("TargetCells", "target-cells")
    assert "  target-cells   Print the target cells of a scenario\n" in called().stdout
    done = called("target-cells", "--scenario", "4", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    *lines, content = done.stdout.splitlines()
    found = json.loads(content)
    assert found["scenario"] == "4"
    assert lines == [f"r{k}: {x} {y}" for k, (x, y) in enumerate(found["targets"], start=1)]
    assert called("target-cells", "--scenario", "1a").returncode == 1
    for wrong, message in (("--robots", "0"), "robots = 0"), (("--scenario", "9"), "unknown"):
        refused = called("target-cells", *wrong)
        assert (refused.returncode, refused.stdout) == (2, "")
        assert refused.stderr.startswith(f"error: {message}")
    assert "target-cells" in called("--tyro-print-completion", "bash").stdout
    assert "examples:" not in called("target-cells", "--help").stdout  # no page shows it


def test_commands_pass_on_what_they_are_given(command, monkeypatch, tmp_path):
    """Without training, simulating or replaying anything."""
    taken: list[Any] = []

    def take(*arguments: Any, **named: Any) -> None:
        taken.append((arguments, named))
        raise UserError("taken")

    monkeypatch.setattr("agent.training.methods.method_config", take)
    monkeypatch.setattr("analysis.compare.replay", take)
    for seed in ((), ("--train-seed", 3)):
        done = command("run", "--scenario", "1a", "--seed", 5, *seed, "--out", tmp_path / "r")
        assert "taken" in done.stderr
    worlds = WorldRange(mu=(0.1, 0.3))
    with pytest.raises(UserError, match="taken"):
        agent.train("1a", method="moves", worlds=worlds, progress=None)
    command("replay", "a.rrd", "--policy", "p.npz", "--motor-fmu", "m.fmu")
    (first, second, train, replayed) = taken
    assert [arguments[2] for arguments, _ in (first, second)] == [0, 3]
    assert train[1]["worlds"] == worlds
    assert replayed[0][:3] == (Path("a.rrd"), Path("p.npz"), Path("m.fmu"))


def test_a_budget_of_time_reaches_the_threads(monkeypatch):
    asked: list[Any] = []
    monkeypatch.setattr(store, "run_jobs", lambda _, __, *may_begin: asked.extend(may_begin) or [])
    monkeypatch.setattr(store, "compile_kernels", lambda *_: None)
    job: Any = SimpleNamespace(key=1, task=lambda: None)
    keeps: Any = SimpleNamespace(find=lambda _: None)

    def may_begin() -> bool:
        return False

    assert [*store.simulate_missing([job], keeps, Workers(jobs=1), may_begin=may_begin)] == []
    assert asked == [may_begin]

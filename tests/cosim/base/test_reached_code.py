"""The code that a result depends on: the same whatever it is called, another after a change."""

import ast
import re
import shutil
from typing import Any

import pytest

from cosim.base import reached_code
from cosim.base.reached_code import INFRASTRUCTURE, OWN, ROOT, code_digest

EVALUATION = ("agent.evaluation.cases:run_jobs", "agent.evaluation.cases:Case")


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A copy of the project, of which digests are taken; its files are changed by `replace`."""
    for package in OWN:
        shutil.copytree(ROOT / package, tmp_path / package, ignore=lambda folder, names: [
            n for n in names if n == "__pycache__" or n.endswith((".c", ".h"))
        ])  # fmt: skip
    monkeypatch.setattr(reached_code, "ROOT", tmp_path)
    forget()
    yield tmp_path
    forget()


def forget():
    reached_code._path.cache_clear()
    reached_code._source.cache_clear()


def replace(path, old, new):
    text = path.read_text("utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    forget()


def test_a_copy_has_the_same_identity(project):
    copied = code_digest(*EVALUATION)
    reached_code.ROOT = ROOT
    forget()
    assert code_digest(*EVALUATION) == copied


def test_renamed_modules_keep_the_identity(project):
    before = code_digest(*EVALUATION)
    for package, old, new in (
        ("cosim.coupling", "master", "ticking"), ("cosim.onboard", "steering", "driving"),
        ("cosim.model", "params", "parameters"),
    ):  # fmt: skip
        folder = project.joinpath(*package.split("."))
        (folder / f"{old}.py").rename(folder / f"{new}.py")
        for path in project.rglob("*.py"):
            text = path.read_text("utf-8").replace(f"{package}.{old} ", f"{package}.{new} ")
            of_module = re.compile(rf"(from {re.escape(package)} import .*)\b{old}\b")
            path.write_text(of_module.sub(rf"\1{new} as {old}", text), encoding="utf-8")
    forget()
    assert code_digest(*EVALUATION) == before


@pytest.mark.parametrize(
    ("module", "old", "new"),
    [
        ("cosim/model/world.py", "raise WorldError(", "raise WorldError('Sorry: ' + "),
        ("cosim/model/config.py", "Everything but", "All but"),
        ("cosim/coupling/master.py", "import numpy as np\n", "import numpy as np  # arrays\n"),
        ("cosim/model/world.py", "mu: float", "mu: int"),
        ("cosim/coupling/fmu.py", "# ", "# Note: "),
    ],
)
def test_prose_keeps_the_identity(project, module, old, new):
    before = code_digest(*EVALUATION)
    replace(project / module, old, new)
    assert code_digest(*EVALUATION) == before


def test_help_texts_keep_the_identity(project):
    options = "cosim.simulation.options:SimulationOptions"
    before = code_digest(options)
    for module, old, new in (
        ("cosim/simulation/options.py", "Coulomb friction", "Friction"),
        ("cosim/base/command.py", "Motor FMU to use", "FMU to use"),
    ):
        replace(project / module, old, new)
    assert code_digest(options) == before


@pytest.mark.parametrize(
    ("module", "old", "new"),
    [
        ("cosim/model/params.py", "0.00177", "0.00178"),
        ("cosim/physics/rotation.py", " - ", " + "),
        ("cosim/simulation/result.py", "is not None", "is None"),
        ("cosim/model/outcome.py", "COLLISION", "CRASH"),
    ],
)
def test_code_gives_another_identity(project, module, old, new):
    before = code_digest(*EVALUATION)
    replace(project / module, old, new)
    assert code_digest(*EVALUATION) != before


MODULE = """
from dataclasses import dataclass
from functools import partial

LIMIT = 3
UNUSED = 4


@dataclass
class Robot:
    speed: float = 1.0
    '''Of its motors.'''

    def drive(self, seconds=2.0):
        if seconds < 0:
            raise ValueError(f"seconds = {seconds} is negative")
        return self.speed * min(seconds, LIMIT)

    def unused(self):
        return 0

    def __len__(self):
        return 1


TABLE = {}
for name in ("a", "b"):
    TABLE[name] = 1


def further(robot: Robot):
    return helper(robot) + getattr(robot, "reach")()


helper = partial(lambda robot, scale: scale * robot.drive(), scale=2)


class Long(Robot):
    def reach(self):
        return 5


def root():
    return further(Long())
"""


@pytest.mark.parametrize(
    ("old", "new", "same"),
    [
        ("is negative", "must not be negative", True),
        ("Of its motors.", "Of the robot.", True),
        ("speed: float", "speed: int", True),
        ("UNUSED = 4", "UNUSED = 5", True),
        ("return 0", "return 1", True),
        ("LIMIT = 3", "LIMIT = 4", False),
        ("speed: float = 1.0", "speed: float = 2.0", False),
        ("seconds=2.0", "seconds=3.0", False),
        ("self.speed * min", "self.speed + min", False),
        ("scale=2", "scale=3", False),
        ("return 5", "return 6", False),
        ("        return 1", "        return 2", False),
        ("TABLE[name] = 1", "TABLE[name] = 2", False),
        ("@dataclass", "@dataclass(order=True)", False),
        ("seconds < 0", "seconds <= 0", False),
        ("raise ValueError", "raise TypeError", False),
    ],
)
def test_what_is_reached(project, old, new, same):
    path = project / "cosim" / "tried.py"
    path.write_text(MODULE)
    before = code_digest("cosim.tried:root")
    replace(path, old, new)
    assert (code_digest("cosim.tried:root") == before) == same


def test_a_policy_of_a_user_is_part_of_it(project, monkeypatch):
    module = project / "mine.py"
    digests = []
    for action in (1, 2):
        module.write_text(f"class Mine:\n    def act(self, seen):\n        return {action}\n")
        forget()
        digests.append(code_digest("mine:Mine"))
    assert digests[0] != digests[1]


def test_modules_are_left_out_with_what_only_they_reach():
    simulation, recording = "cosim.simulation.simulate", "cosim.recording.episode"
    assert code_digest(simulation) != code_digest(simulation, but=[recording])


def test_infrastructure_exists():
    assert all(reached_code._path(module) for module in INFRASTRUCTURE)


def test_fields_that_newer_pythons_add_to_syntax_give_the_same_identity():
    newer: Any = type("Return", (ast.Return,), {"_fields": ("value", "type_params")})
    value, reader = ast.Constant(1), reached_code._SyntaxReader({})
    assert reader.text(newer(value, type_params=[])) == reader.text(ast.Return(value))

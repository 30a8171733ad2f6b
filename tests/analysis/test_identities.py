"""Whatever is stored has the code that made it in its identity: all of it, and nothing else."""

import numba
import pytest

from agent.bound import optimum
from agent.identify import transitions_path
from agent.learning import LearningConfig, initial_state
from agent.policy import Policy, PolicyConfig, Seed
from agent.process import ProcessConfig, build_process
from agent.store import policy_folder
from analysis.timings import Timings, code_of
from cosim import jit, sources
from cosim.calibrating import digest
from cosim.config import CoSimConfig
from cosim.evaluation import Case
from cosim.scenario import Scenario
from cosim.sources import ROOT
from cosim.storage import cache_dir
from fmus.build import cached_fmu

SMALL = Scenario("small", "", ((4, 4),), (((0, 0),),), columns=6, rows=6, zone=(0, 0, 0, 0))


def policy_config() -> PolicyConfig:
    return PolicyConfig(SMALL, ProcessConfig(), LearningConfig(episodes=1), Seed(0))


def bounds() -> set[str]:
    """Files of bounds once that of a small scenario is there."""
    optimum(build_process(SMALL, ProcessConfig()))
    return {path.name for path in cache_dir("bounds").iterdir()}


def evaluation() -> str:
    config = PolicyConfig(
        SMALL, ProcessConfig(), LearningConfig(episodes=1), Seed(0), kernel_version="any"
    )
    state = initial_state(build_process(SMALL, config.process), config.learning, 0)
    return Case(Policy.of_training(config, state), CoSimConfig(), cached_fmu(), 0).digest


IDENTITIES = {
    "bound": bounds,
    "calibration": lambda: digest(CoSimConfig(), cached_fmu()),
    "evaluation": evaluation,
    "kernels": lambda: sources.source_digest(jit._kernel_sources(), numba.__version__),
    "moves": lambda: transitions_path(CoSimConfig(), cached_fmu()).name,
    "policy": lambda: policy_folder(policy_config()).name,
    "reproduced experiment": lambda: code_of("fig08"),
    "reproduced motor test": lambda: code_of("motor_test"),
    "reproduced transfer": lambda: code_of("transfer"),
}

MECHANICS = "body collision config contact fmu forces master params plant rotation signals steering"
EPISODE = f"{MECHANICS} episode features measures observing safety scenario"
PROCESS = "grid process rng"
LEARNING = f"{PROCESS} evaluation learning maps qlearning timed timed_learning training transitions"
# Modules that matter, and modules that do not, by package.
ON_THE_WAY = {
    "bound": {"agent": f"{PROCESS} bound evaluation", "cosim": "features scenario"},
    "calibration": {"cosim": f"{MECHANICS} calibrating calibration trial"},
    "evaluation": {
        "agent": f"{PROCESS} evaluation policy",
        "cosim": f"{EPISODE} evaluation rollout",
    },
    "kernels": {
        "agent": f"{PROCESS} bound evaluation qlearning timed timed_learning vector_env",
        "cosim": "body contact features forces params plant rotation steering",
    },
    "moves": {
        "agent": "identify transitions",
        "cosim": f"{EPISODE} calibrating calibration trial",
        "fmus": "variables",
    },
    "policy": {"agent": LEARNING, "cosim": "features params scenario"},
    "reproduced experiment": {"agent": f"{LEARNING} bound experiments", "cosim": "scenario"},
    "reproduced motor test": {"analysis": "motor_test", "cosim": "params recording"},
    "reproduced transfer": {
        "agent": f"{LEARNING} identify methods",
        "cosim": f"{EPISODE} calibration outcomes rollout transfer transfer_table",
        "fmus": "build variables",
    },
}
ELSEWHERE = {
    "bound": {"agent": "qlearning train", "analysis": "style", "cosim": "body"},
    "calibration": {"agent": "grid", "analysis": "style", "cosim": "episode recording run"},
    "evaluation": {
        "agent": "timed train",
        "analysis": "style",
        "cosim": "blueprint episode_recording outcomes recording run transfer",
    },
    "kernels": {"agent": "train", "analysis": "style", "cosim": "blueprint run"},
    "moves": {"agent": "grid qlearning", "analysis": "style", "cosim": "blueprint run"},
    "policy": {"agent": "store train", "analysis": "style", "cosim": "body episode run"},
    "reproduced experiment": {
        "agent": "identify",
        "analysis": "style figures",
        "cosim": "body run",
    },
    "reproduced motor test": {"agent": "grid", "analysis": "figures", "cosim": "run"},
    "reproduced transfer": {"agent": "experiments", "analysis": "style", "cosim": "run"},
}
LAID_OUT = {"kernels"}  # compiled code knows its lines


def modules(where: dict[str, dict[str, str]]) -> list:
    return [
        (kind, f"{package}/{name}.py")
        for kind, packages in where.items()
        for package, names in packages.items()
        for name in names.split()
    ]


@pytest.fixture
def change(monkeypatch):
    """Makes a module read as if it had another line at its end."""

    def content(module: str, line: str) -> None:
        path = ROOT / module
        assert path.is_file()
        read = sources.content
        monkeypatch.setattr(
            sources, "content", lambda p: read(p) + (line.encode() if p == path else b"")
        )

    return content


@pytest.fixture
def identity(tmp_path, monkeypatch):
    """What kinds of results are known by; bounds are in a cache of the test's own."""
    fmu = cached_fmu()
    monkeypatch.setattr(f"{__name__}.cached_fmu", lambda: fmu)
    monkeypatch.setenv("MINIROBOTS_CACHE", str(tmp_path))
    return IDENTITIES


@pytest.mark.parametrize(("kind", "module"), modules(ON_THE_WAY))
def test_a_change_on_the_way_gives_another_identity(kind, module, identity, change):
    before = identity[kind]()
    change(module, "\nCHANGED = 1\n")
    assert identity[kind]() != before


@pytest.mark.parametrize(("kind", "module"), modules(ELSEWHERE))
def test_a_change_elsewhere_gives_the_same_identity(kind, module, identity, change):
    before = identity[kind]()
    change(module, "\nCHANGED = 1\n")
    assert identity[kind]() == before


@pytest.mark.parametrize("kind", sorted(IDENTITIES.keys() - LAID_OUT))
def test_a_comment_gives_the_same_identity(kind, identity, change):
    before = identity[kind]()
    for _, module in modules({kind: ON_THE_WAY[kind]}):
        change(module, "\n# changed\n")
    assert identity[kind]() == before


def test_a_stage_that_other_code_has_finished_is_not_finished(tmp_path, tiny, change):
    timings = Timings(tmp_path, tiny, seed=0)
    for stage in ("fig08", "platform"):
        with timings.stage(stage):
            pass
    change("agent/qlearning.py", "\nCHANGED = 1\n")
    again = Timings(tmp_path, tiny, seed=0)
    assert (again.finished("fig08"), again.finished("platform")) == (False, True)
    with again.stage("fig08"):
        pass
    assert again.finished("fig08")

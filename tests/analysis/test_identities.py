"""Whatever is stored has the code that made it in its identity: all of it, and nothing else."""

import ast
from collections.abc import Callable

import pytest

from agent.evaluation.cases import Case
from agent.mdp.config import ProcessConfig
from agent.mdp.optimum import optimum
from agent.mdp.readings import build_process
from agent.moves.observe import moves_path
from agent.training.learning import initial_state
from agent.training.policy import Policy, PolicyConfig, Seed
from agent.training.settings import LearningConfig
from agent.training.store import policy_folder
from analysis.timings import Timings, code_of
from cosim.base import reached_code
from cosim.base.reached_code import ROOT
from cosim.base.storage import cache_dir
from cosim.calibration.cache import digest
from cosim.model.config import CoSimConfig
from cosim.model.scenario import Scenario
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
    "moves": lambda: moves_path(CoSimConfig(), cached_fmu()).name,
    "policy": lambda: policy_folder(policy_config()).name,
    "reproduced experiment": lambda: code_of("fig08"),
    "reproduced motor test": lambda: code_of("motor_test"),
    "reproduced transfer": lambda: code_of("transfer"),
}

# Modules that matter, and modules that do not.
MATTER = {
    "bound": """
        agent.mdp.exact agent.mdp.grid agent.mdp.joint
        agent.mdp.optimum agent.mdp.readings agent.mdp.rng
        cosim.onboard.features
    """,
    "calibration": """
        cosim.model.config cosim.model.params cosim.coupling.fmu cosim.coupling.master
        cosim.coupling.plant cosim.coupling.signals cosim.onboard.steering
        cosim.calibration.speed_map cosim.calibration.measuring
        cosim.calibration.trial cosim.physics.body cosim.physics.collision
        cosim.physics.contact cosim.physics.forces cosim.physics.rotation
    """,
    "evaluation": """
        agent.evaluation.cases agent.mdp.config agent.mdp.exact
        agent.mdp.greedy agent.mdp.grid
        agent.mdp.readings agent.mdp.rng agent.training.policy cosim.model.config
        cosim.model.params cosim.model.scenario cosim.coupling.fmu cosim.coupling.master
        cosim.coupling.plant cosim.coupling.signals cosim.onboard.steering
        cosim.simulation.episode cosim.onboard.features cosim.simulation.measures
        cosim.onboard.observing cosim.onboard.yielding cosim.physics.body
        cosim.physics.collision cosim.physics.contact cosim.physics.forces
        cosim.physics.rotation
    """,
    "moves": """
        agent.moves.model agent.moves.observe cosim.model.config cosim.model.params
        cosim.model.scenario cosim.coupling.fmu cosim.coupling.master cosim.coupling.plant
        cosim.coupling.signals cosim.onboard.steering cosim.simulation.episode
        cosim.onboard.features cosim.simulation.measures cosim.onboard.observing
        cosim.onboard.yielding cosim.physics.body cosim.physics.collision
        cosim.physics.contact cosim.physics.forces cosim.physics.rotation fmus.variables
    """,
    "policy": """
        agent.moves.kernels agent.moves.model agent.mdp.config agent.mdp.exact
        agent.mdp.grid agent.mdp.readings agent.mdp.rng
        agent.training.learning agent.training.loop agent.training.moves_qlearning
        agent.training.qlearning agent.training.settings cosim.model.params
        cosim.model.scenario cosim.onboard.features
    """,
    "reproduced experiment": """
        agent.experiments.results agent.experiments.run agent.experiments.variants
        agent.moves.kernels agent.moves.model agent.mdp.config agent.mdp.exact
        agent.mdp.grid agent.mdp.optimum agent.mdp.readings
        agent.mdp.rng agent.training.learning agent.training.loop
        agent.training.moves_qlearning agent.training.qlearning agent.training.settings
        cosim.model.scenario
    """,
    "reproduced motor test": """
        analysis.motor.step_test cosim.model.params cosim.recording.file
    """,
    "reproduced transfer": """
        agent.evaluation.outcomes agent.study.episodes
        agent.study.transfer agent.method agent.moves.kernels
        agent.moves.model agent.moves.observe agent.mdp.config agent.mdp.exact
        agent.mdp.grid agent.mdp.readings agent.mdp.rng
        agent.training.learning agent.training.loop agent.training.moves_qlearning
        agent.training.qlearning agent.training.settings cosim.model.config
        cosim.model.params cosim.model.scenario cosim.coupling.fmu cosim.coupling.master
        cosim.coupling.plant cosim.coupling.signals cosim.onboard.steering
        cosim.calibration.speed_map cosim.simulation.episode cosim.onboard.features
        cosim.simulation.measures cosim.onboard.observing cosim.onboard.yielding
        cosim.physics.body cosim.physics.collision cosim.physics.contact
        cosim.physics.forces cosim.physics.rotation fmus.build fmus.variables
    """,
}
ELSEWHERE = {
    "bound": """
        minirobots.commands.train agent.training.qlearning analysis.figures.style
        cosim.physics.body
    """,
    "calibration": """
        agent.mdp.grid analysis.figures.style cosim.simulation.episode
        cosim.recording.file minirobots.commands.run
    """,
    "evaluation": """
        agent.evaluation.outcomes agent.study.transfer minirobots.commands.train
        agent.moves.kernels analysis.figures.style cosim.recording.blueprint
        cosim.recording.episode cosim.recording.file minirobots.commands.run
    """,
    "moves": """
        agent.mdp.grid agent.training.qlearning analysis.figures.style
        cosim.recording.blueprint minirobots.commands.run
    """,
    "policy": """
        minirobots.commands.train agent.training.store analysis.figures.style
        cosim.simulation.episode cosim.physics.body minirobots.commands.run
    """,
    "reproduced experiment": """
        agent.moves.observe analysis.figures.draw analysis.figures.style
        cosim.physics.body minirobots.commands.run
    """,
    "reproduced motor test": """
        agent.mdp.grid analysis.figures.draw minirobots.commands.run
    """,
    "reproduced transfer": """
        agent.experiments.run analysis.figures.style minirobots.commands.run
    """,
}


def modules(where: dict[str, str]) -> list[tuple[str, str]]:
    return [
        (kind, f"{name.replace('.', '/')}.py")
        for kind, names in where.items()
        for name in names.split()
    ]


def _changed(source: bytes) -> bytes:
    """Every function and class of a module with a statement more, and every number another."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            node.body.append(ast.Pass())
        elif isinstance(node, ast.Constant) and isinstance(node.value, float):
            node.value += 1.0
    return ast.unparse(tree).encode()


def _commented(source: bytes) -> bytes:
    return source + b"\n# changed\n"


@pytest.fixture
def change(monkeypatch):
    """Makes a module read as if it were another."""

    def content(module: str, changed: Callable[[bytes], bytes]) -> None:
        path = ROOT / module
        assert path.is_file()
        read = reached_code.content
        monkeypatch.setattr(
            reached_code, "content", lambda p: changed(read(p)) if p == path else read(p)
        )
        reached_code._source.cache_clear()

    yield content
    reached_code._source.cache_clear()


@pytest.fixture
def identity(tmp_path, monkeypatch):
    """What kinds of results are known by; bounds are in a cache of the test's own."""
    fmu = cached_fmu()
    monkeypatch.setattr(f"{__name__}.cached_fmu", lambda: fmu)
    monkeypatch.setenv("MINIROBOTS_CACHE", str(tmp_path))
    return IDENTITIES


@pytest.mark.parametrize(("kind", "module"), modules(MATTER))
def test_a_change_that_matters_gives_another_identity(kind, module, identity, change):
    before = identity[kind]()
    change(module, _changed)
    assert identity[kind]() != before


@pytest.mark.parametrize(("kind", "module"), modules(ELSEWHERE))
def test_a_change_elsewhere_gives_the_same_identity(kind, module, identity, change):
    before = identity[kind]()
    change(module, _changed)
    assert identity[kind]() == before


@pytest.mark.parametrize("kind", sorted(IDENTITIES))
def test_a_comment_gives_the_same_identity(kind, identity, change):
    before = identity[kind]()
    for _, module in modules({kind: MATTER[kind]}):
        change(module, _commented)
    assert identity[kind]() == before


def test_a_stage_that_other_code_has_finished_is_not_finished(tmp_path, tiny, change):
    timings = Timings(tmp_path, tiny, seed=0)
    for stage in ("fig08", "platform"):
        with timings.stage(stage):
            pass
    change("agent/training/qlearning.py", _changed)
    again = Timings(tmp_path, tiny, seed=0)
    assert (again.finished("fig08"), again.finished("platform")) == (False, True)
    with again.stage("fig08"):
        pass
    assert again.finished("fig08")

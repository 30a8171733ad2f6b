"""Train one network for all robots of a scenario."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import msgspec

from agent.deep import NetworkAlgorithm, require_learners
from cosim.base.errors import UserError, in_shell
from cosim.base.progress import Progress
from minirobots.options import Count, NewFolder, ScenarioName, Seed


class Deep(NewFolder):
    """Train one network that all robots of a scenario share, on the grid.

    The network sees a robot's cell and target, the nearest other robot and whether that one has
    arrived. Episodes begin in any free cells of the board, moves off the board and into obstacles
    are masked, and rewards are shaped by the shortest path of a robot alone. After every round the
    greedy policy is evaluated from all starts; the best one is kept as policy.npz, which
    minirobots run --policy, minirobots evaluate and agent.evaluate accept. Needs the extra deep.
    """

    prefix: ClassVar[str] = "deep-"

    scenario: ScenarioName = "2"
    algorithm: NetworkAlgorithm = "ippo"
    """Learner: PPO of skrl with a critic that sees what the robot sees (ippo) or the cells of all
    robots too (mappo), or double Q-learning with a network (ddqn)."""
    any_target: bool = False
    """Whether targets are drawn in training, so that one network drives to any: in scenarios that
    differ in targets and starts only, and in pages, where a click sets them."""
    steps: Count = 1_500_000
    """Moves of all robots together to train on."""
    seed: Seed = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.seed >= 2**32:
            raise UserError("--seed must be from 0 to 4294967295")


class DeepReport(msgspec.Struct, frozen=True, kw_only=True):
    """Result of a training.

    Attributes:
        schema_version: of the report.
        scenario: name.
        algorithm: of learning.
        seed: of training.
        policy: file of the best policy.
        success: share of the starts from which it succeeds on the grid: all, or a thousand of them.
        agent_steps: moves of all robots.
        seconds: wall-clock time of training, evaluations included.
        curve: (agent steps, seconds, success) after every round.
    """

    schema_version: int = 1
    scenario: str
    algorithm: str
    seed: int
    policy: str
    success: float
    agent_steps: int
    seconds: float
    curve: tuple[Any, ...]


def run(options: Deep, progress: Progress) -> Iterator[Any]:
    """Train, write `policy.npz` and `deep.json`, and print the result and how to try it."""
    from cosim.base.storage import write_json
    from cosim.model.scenario_file import find_scenario

    scenario = find_scenario(options.scenario)
    require_learners()
    from agent.deep.learners import train
    from agent.deep.learning_grid import SHAPING
    from agent.deep.policy import NetworkConfig
    from agent.training.policy import Seed

    process, seed = SHAPING[options.algorithm].process, Seed(options.seed)
    made = options.algorithm, options.steps, seed
    config = NetworkConfig(scenario, process, *made, any_target=options.any_target)

    out = options.folder
    out.mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    curve = []
    policy = train(config, progress, curve.append)
    policy.save(out / "policy.npz")
    report = DeepReport(
        scenario=scenario.name,
        algorithm=options.algorithm,
        seed=options.seed,
        policy=str(out / "policy.npz"),
        success=max(point.success for point in curve),
        agent_steps=curve[-1].agent_steps,
        seconds=time.perf_counter() - began,
        curve=tuple(curve),
    )
    write_json(out / "deep.json", report)
    yield report
    print(
        f"success from {100.0 * report.success:.1f} % of the starts on the grid, after "
        f"{report.agent_steps:,} moves in {report.seconds:.0f} s"
    )
    print(f"results in {Path(report.policy).parent}/: policy.npz, deep.json")
    print(
        f"try it with: {in_shell('minirobots')} run --scenario {options.scenario} "
        f"--policy {report.policy}"
    )

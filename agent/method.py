"""The methods that are compared in co-simulation, by name, and the policies they give.

"paper" learns on the deterministic grid (Section V), "slip" on the grid where moves go astray,
"moves" on moves observed in co-simulation, with the bearing of the other robot, "robust" on moves
of many worlds (`agent.moves.worlds`). "pair" learns the time that two robots still take together,
on moves of robots that are asked when their moves end and drive through cells (`--through`).
"shortest" learns nothing: the joint paths on the grid that are optimal by the length of all
robots' paths together, which are computed. So is "fastest", the least time on observed moves,
which tells turns from straight lines, of one robot or of two together (two on moves through
cells). "planned" is for groups: robots plan in space and time on mean
times of moves, again at every decision (`agent.moves.group`).
`minirobots run` uses "moves" for one robot, "pair" for two, and "planned" for more.
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from agent.mdp import optimum
from agent.mdp.config import ProcessConfig
from agent.mdp.readings import MAX_JOINT_STATES
from agent.moves import bound, group, pair
from agent.moves.model import ObservedMoves
from agent.moves.observe import cached_moves
from agent.moves.worlds import RANGES, WorldRange
from agent.training.group_policy import GroupPolicy, can_plan
from agent.training.loop import TrainingLog, TrainingProgress
from agent.training.pair_policy import PairPolicy
from agent.training.policy import Policy, PolicyConfig, Seed
from agent.training.settings import BEST, COMPUTED, METHODS, LearningConfig, Method, refuse_former
from agent.training.store import find_or_compute, find_or_train
from cosim.base.command import MotorParameters
from cosim.base.errors import UserError
from cosim.base.progress import Progress, silent
from cosim.base.reached_code import code_digest
from cosim.calibration.cache import calibrated_slower
from cosim.model.scenario import Scenario
from cosim.onboard.features import AXIS_COUNT
from cosim.simulation.options import DecisionOptions, Physics


class MoveSource(NamedTuple):
    """Moves that a method learns on: of which worlds, and whether robots drive through cells."""

    worlds: WorldRange | None = None
    through: bool = False


ON_MOVES = {
    "moves": MoveSource(),
    "robust": MoveSource(RANGES),
    "pair": MoveSource(through=True),
    "fastest": MoveSource(),
    "planned": MoveSource(through=True),
}


def moves_of(method: str, scenario: Scenario) -> MoveSource | None:
    """Return the moves that a method uses in a scenario; None if it uses the grid alone."""
    pair = method == "fastest" and scenario.robots > 1
    return MoveSource(through=True) if pair else ON_MOVES.get(method)


MOVES_EPISODES, ROBUST_EPISODES, PAIR_EPISODES = 1_500_000, 3_000_000, 400_000
CLEARANCE_M = 0.005  # assumed: errors of two estimates, and of what robots do by them
SLIP_PROBABILITY = 0.2  # assumed
# Fields of a `LearningConfig` that do not belong to a method: how long, and what is logged.
_FREE = ("episodes", "log_episodes", "log_window", "greedy_points")


def best_method(scenario: Scenario) -> Method:
    """Return the default method: "pair" for two, "planned" for more, "moves" for large boards."""
    if scenario.robots > 2 and can_plan(scenario):
        return "planned"
    joint_states = AXIS_COUNT * (scenario.columns * scenario.rows) ** 2
    return "pair" if scenario.robots == 2 and joint_states <= MAX_JOINT_STATES else BEST


def method_config(
    method: str,
    scenario: Scenario,
    seed: int = 0,
    *,
    episodes: int | None = None,
    motor_fmu: Path | None = None,
    motor_parameters: MotorParameters = (),
    progress: Progress = silent,
) -> PolicyConfig:
    """Configuration of a method for a scenario; "moves" may have to observe moves first.

    Args:
        method: one of METHODS.
        scenario: board, starts and targets.
        seed: of training; a computed policy has none.
        episodes: training episodes, the method's own number by default.
        motor_fmu: motor FMU of the observed moves, the built-in one by default.
        motor_parameters: of the motor FMU, set through FMI while moves are observed.
        progress: receives what is calibrated and observed.

    Raises:
        UserError: the method is unknown, there are episodes and it is computed, the fastest paths
            of several robots are asked for, or moves cannot be observed.
    """
    refuse_former(method, "method")
    if method not in METHODS:
        raise UserError(f"method {method!r} is unknown; choose one of {', '.join(METHODS)}")
    process, learning = _settings(method, scenario)
    if method in COMPUTED:
        if episodes is not None:
            raise UserError(
                f"method {method} is computed, not trained; leave out the number of episodes, or "
                "choose a method that learns, such as moves"
            )
        if method == "fastest" and scenario.robots > 2:
            raise UserError(
                f"fastest paths are computed for one robot or two, and scenario {scenario.name} "
                f"has {scenario.robots}; choose a method that learns"
            )
    if method == "pair" and scenario.robots != 2:
        raise UserError(
            f"method pair is for two robots, and scenario {scenario.name} has {scenario.robots}; "
            "choose another method, such as moves"
        )
    moves, driven = None, moves_of(method, scenario)
    if driven is not None:
        motors = Physics(motor_fmu=motor_fmu, motor_parameters=motor_parameters)
        moves = _observed_moves(scenario, motors, driven, progress)
    if method in COMPUTED:
        code = code_digest(optimum, bound, pair, group)
        return PolicyConfig(
            scenario, process, learning, Seed(0), moves, objective=method, kernel_version=code
        )
    if episodes is not None:
        learning = replace(learning, episodes=episodes)
    return PolicyConfig(scenario, process, learning, Seed.of(seed), moves)


def method_of(config: PolicyConfig) -> Method | None:
    """The method that a policy was trained by, for any seed, episodes and observed moves.

    None if it is none of METHODS: interpretations or numbers of learning were chosen.
    """
    moves = config.moves
    driven = None if moves is None else MoveSource(RANGES if moves.walks else None, moves.through)
    free = {name: getattr(config.learning, name) for name in _FREE}
    for method in METHODS:
        process, learning = _settings(method, config.scenario)
        objective = method if method in COMPUTED else None
        expected = process, replace(learning, **free), moves_of(method, config.scenario), objective
        if (config.process, config.learning, driven, config.objective) == expected:
            return method
    return None


def _settings(method: str, scenario: Scenario) -> tuple[ProcessConfig, LearningConfig]:
    if method == "planned":
        return ProcessConfig(features=("x", "y", "h")), LearningConfig()
    if method == "fastest":
        features = ("x", "y", "h") if scenario.robots == 1 else ("x", "y", "h", "p")
        return ProcessConfig(features=features), LearningConfig()
    if method in COMPUTED:
        features = ("x", "y") if scenario.robots == 1 else ("x", "y", "p")
        return ProcessConfig(features=features), LearningConfig()
    if method not in ON_MOVES:
        slip = SLIP_PROBABILITY if method == "slip" else 0.0
        return ProcessConfig(slip_probability=slip), LearningConfig()
    if method == "pair":
        process = ProcessConfig(features=("x", "y", "h", "p"), clearance_m=CLEARANCE_M)
        learning = LearningConfig(
            PAIR_EPISODES,
            eta=0.5,
            eta_end=0.02,
            gamma=1.0,
            epsilon=0.2,
            exploration=0.8,
            schedule="linear",
            algorithm="pair",
            greedy_points=10,
        )
        return process, learning
    # Chosen on the observed moves: a learning rate three times the paper's, and a collision that
    # costs more than any detour.
    features = ("x", "y", "h") if scenario.robots == 1 else ("x", "y", "d", "g", "b")
    process = ProcessConfig(goal_reward=300.0, features=features)
    learning = LearningConfig(episodes=MOVES_EPISODES, eta=0.03)
    if method == "moves":
        return process, learning
    # Robots of unequal motors drift by up to a cell while they turn, and turns take time: what a
    # move costs depends on where they face, pairs too. The gradient's sign tells them nothing that
    # helps. What moves do differs so much that only a falling rate tells directions apart.
    if scenario.robots > 1:
        features = ("x", "y", "d", "b", "h")
    process = replace(process, features=features, clearance_m=CLEARANCE_M)
    return process, replace(learning, episodes=ROBUST_EPISODES, eta_end=0.002, gamma=0.995)


def _observed_moves(
    scenario: Scenario, motors: Physics, driven: MoveSource, progress: Progress
) -> ObservedMoves:
    """Return moves of the scenario's robots with these motors, and defaults for all else."""
    fmu = motors.fmu(progress)
    config = calibrated_slower(motors.config().sized(scenario.robot_diameter_m), fmu, progress)
    config = DecisionOptions(through=driven.through).deciding(config)
    return cached_moves(config, fmu, progress, driven.worlds)


def method_policy(
    method: str,
    scenario: Scenario,
    seed: int = 0,
    *,
    episodes: int | None = None,
    motor_fmu: Path | None = None,
    motor_parameters: MotorParameters = (),
    again: bool = False,
    progress: Progress = silent,
) -> tuple[Policy | PairPolicy | GroupPolicy, TrainingLog | None, Path]:
    """The policy of a method: found in the cache, or trained or computed and kept there.

    Args:
        method, scenario, seed, episodes, motor_fmu, motor_parameters: see `method_config`.
        again: make it even if the policy is there.
        progress: receives what is calibrated, observed and trained; nothing if the policy is found.

    Returns:
        The policy, its learning curves (none if it was computed) and the path of its file.

    Raises:
        UserError: the scenario cannot be used, see `method_config`.
    """
    config = method_config(
        method,
        scenario,
        seed,
        episodes=episodes,
        motor_fmu=motor_fmu,
        motor_parameters=motor_parameters,
        progress=progress,
    )
    if config.objective is not None:
        policy, path = find_or_compute(config, again=again)
        return policy, None, path

    def training(now: TrainingProgress) -> None:
        state = f"success {now.success:.1%}  ε {now.epsilon:.3f}"
        progress("training", now.episode, now.episodes, state)

    return find_or_train(config, again=again, progress=training)

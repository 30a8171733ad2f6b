"""The methods that are compared in co-simulation, by name, and the policies they give.

"paper" learns on the deterministic grid (Section V), "moves" on moves observed in co-simulation,
with the bearing of the other robot; each walk of these may have a world of its own
(`agent.moves.worlds`). "shortest" learns nothing: the joint paths on the grid that are optimal by
the length of all robots' paths together, which are computed. So is "fastest", the least time on
observed moves, which tells turns from straight lines, of one robot or of two together (two on
moves through cells). "planned" is for groups: robots plan in space and time on mean times of
moves, again at every decision (`agent.moves.group`). Defaults are those of `best_method`.
"""

from dataclasses import replace
from pathlib import Path

from agent.mdp import optimum
from agent.mdp.config import ProcessConfig
from agent.moves import group, pair
from agent.moves.model import ObservedMoves
from agent.moves.observe import cached_moves
from agent.moves.worlds import WorldRange, checked_ranges
from agent.training.group_policy import GroupPolicy, can_plan
from agent.training.loop import TrainingLog, TrainingProgress
from agent.training.pair_policy import PairPolicy
from agent.training.policy import Policy, PolicyConfig, Seed
from agent.training.settings import COMPUTED, METHODS, LearningConfig, Method
from agent.training.store import find_or_compute, find_or_train
from cosim.base.command import MotorParameters
from cosim.base.errors import UserError
from cosim.base.progress import Progress, silent
from cosim.calibration.cache import calibrated_slower
from cosim.model.scenario import Scenario
from cosim.simulation.options import DecisionOptions, Physics

ON_MOVES = ("moves", "fastest", "planned")
# Fields of a `LearningConfig` that do not belong to a method: how long, and what is logged.
_FREE = ("episodes", "log_episodes", "log_window", "greedy_points")
_VERSIONS = {"shortest": optimum.VERSION, "fastest": pair.VERSION, "planned": group.VERSION}
_LARGE_CELLS = 1000  # assumed: of a board on which one robot or two learn on moves by default


def drives_through(method: str, scenario: Scenario) -> bool:
    """Return whether a method uses moves of robots that drive through cells in a scenario."""
    return method == "planned" or (method == "fastest" and scenario.robots > 1)


def best_method(scenario: Scenario) -> Method:
    """Return the default: "paper" for one robot or two, "planned" for more; else "moves".

    On the grid robots learn paths along obstacles or a forbidden zone that they touch in the
    dynamics.
    """
    if scenario.robots > 2:
        return "planned" if can_plan(scenario) else "moves"
    large = scenario.columns * scenario.rows > _LARGE_CELLS
    blocked = scenario.obstacles or scenario.zone_is_obstacle
    return "moves" if large or blocked else "paper"


def method_config(
    method: str,
    scenario: Scenario,
    seed: int = 0,
    *,
    episodes: int | None = None,
    motor_fmu: Path | None = None,
    motor_parameters: MotorParameters = (),
    worlds: WorldRange | None = None,
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
        worlds: ranges of the worlds that moves are observed in; by default that of the paper.
        progress: receives what is calibrated and observed.

    Raises:
        UserError: the method is unknown, there are episodes and it is computed, the fastest paths
            of more than two robots are asked for, or moves cannot be observed.
    """
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
    moves = None
    if method in ON_MOVES:
        motors = Physics(motor_fmu=motor_fmu, motor_parameters=motor_parameters)
        through = drives_through(method, scenario)
        moves = _observed_moves(scenario, motors, through, worlds, progress)
    if method in COMPUTED:
        version = f"{method} {_VERSIONS[method]}"
        return PolicyConfig(
            scenario, process, learning, Seed(0), moves, objective=method, kernel_version=version
        )
    if episodes is not None:
        learning = replace(learning, episodes=episodes)
    return PolicyConfig(scenario, process, learning, Seed.of(seed), moves)


def method_of(config: PolicyConfig) -> Method | None:
    """The method that a policy was trained by, for any seed, episodes and observed moves.

    None if it is none of METHODS: interpretations or numbers of learning were chosen.
    """
    moves = config.moves
    free = {name: getattr(config.learning, name) for name in _FREE}
    for method in METHODS:
        process, learning = _settings(method, config.scenario)
        objective = method if method in COMPUTED else None
        through = drives_through(method, config.scenario) if method in ON_MOVES else None
        expected = process, replace(learning, **free), through, objective
        driven = None if moves is None else moves.through
        if (config.process, config.learning, driven, config.objective) == expected:
            return method
    return None


def _settings(method: str, scenario: Scenario) -> tuple[ProcessConfig, LearningConfig]:
    alone = scenario.robots == 1
    if method == "moves":
        # Chosen on the observed moves: a learning rate three times the paper's, and a collision
        # that costs more than any detour.
        features = ("x", "y", "h") if alone else ("x", "y", "d", "g", "b")
        process = ProcessConfig(goal_reward=300.0, features=features)
        return process, LearningConfig(episodes=1_500_000, eta=0.03)
    if method == "paper":
        return ProcessConfig(), LearningConfig()
    facing = () if method == "shortest" else ("h",)
    partner = () if alone or method == "planned" else ("p",)
    return ProcessConfig(features=("x", "y", *facing, *partner)), LearningConfig()


def _observed_moves(
    scenario: Scenario,
    motors: Physics,
    through: bool,
    worlds: WorldRange | None,
    progress: Progress,
) -> ObservedMoves:
    """Return moves of the scenario's robots with these motors, and defaults for all else."""
    fmu = motors.fmu(progress)
    config = calibrated_slower(motors.config().sized(scenario.diameter_m), fmu, progress)
    config = config.merged(DecisionOptions(through=through).tree())
    worlds = None if worlds is None else checked_ranges(worlds, config)
    return cached_moves(config, fmu, progress, worlds, scenario.cell_m)


def method_policy(
    method: str,
    scenario: Scenario,
    seed: int = 0,
    *,
    episodes: int | None = None,
    motor_fmu: Path | None = None,
    motor_parameters: MotorParameters = (),
    worlds: WorldRange | None = None,
    again: bool = False,
    progress: Progress = silent,
) -> tuple[Policy | PairPolicy | GroupPolicy, TrainingLog | None, Path]:
    """The policy of a method: found in the cache, or trained or computed and kept there.

    Args:
        method, scenario, seed, episodes, motor_fmu, motor_parameters, worlds: see
            `method_config`.
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
        worlds=worlds,
        progress=progress,
    )
    if config.objective is not None:
        policy, path = find_or_compute(config, again=again)
        return policy, None, path

    def training(now: TrainingProgress) -> None:
        state = f"success {now.success:.1%}  ε {now.epsilon:.3f}"
        progress("training", now.episode, now.episodes, state)

    return find_or_train(config, again=again, progress=training)

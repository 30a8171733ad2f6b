"""The methods that make policies: a record of each, by name, and how a user adds one.

"paper" learns on the deterministic grid (Section V), "moves" on moves observed in co-simulation,
with the bearing of the other robot; each walk of these may have a world of its own
(`agent.moves.worlds`). "shortest" learns nothing: the joint paths on the grid that are optimal by
the length of all robots' paths together, which are computed. So is "fastest", the least time on
observed moves, which tells turns from straight lines, of one robot or of two together (two on
moves through cells). "planned" is for groups: robots plan in space and time on mean times of
moves, again at every decision (`agent.moves.group`).

`learner` and `computed` register further methods, see CONTRIBUTING.md.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, get_args

import numpy as np
from msgspec import Meta

from agent.mdp import optimum
from agent.mdp.config import ProcessConfig
from agent.mdp.greedy import GreedyPolicy
from agent.mdp.interpretations import Process, build_process
from agent.moves import group, pair
from agent.moves.model import ObservedMoves
from agent.moves.observe import cached_moves
from agent.moves.times import fastest_tables
from agent.moves.worlds import WorldRange, checked_ranges
from agent.training.policy import (
    GroupPolicy,
    PairPolicy,
    PolicyConfig,
    Seed,
    can_plan,
    require_plannable,
    table_policy,
)
from agent.training.rules import double_q, q_learning
from agent.training.settings import LearningConfig, MethodName
from cosim.base.arguments import (
    ConfigError,
    imported,
    numbers,
    require_names,
    unknown,
    validate_argument,
)
from cosim.base.errors import UserError, failure, shorten
from cosim.base.progress import Progress, silent
from cosim.calibration.measuring import calibrated
from cosim.fmi.motor import with_motor
from cosim.model.preset import PAPER
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_in_world
from cosim.onboard.features import DIRECTION_COUNT
from cosim.simulation.options import AnyWorld, DecisionOptions, Physics

_PAPER = Physics()  # the paper's machine and motors
_LARGE_CELLS = 1000  # assumed: of a board on which one robot or two learn on moves by default
_MAX_TABLES = 1000
# Fields of a method that its user chooses, with a rule or a function.
_FACTS = ("robots", "needs", "use", "settings", "most_robots")

Settings = Callable[[Scenario], tuple[ProcessConfig, LearningConfig]]


@dataclass(frozen=True)
class Method:
    """One way to make policies. Texts are for people."""

    name: str  # of a user's one "module:function"
    how: str  # it makes a policy
    robots: str = "any"  # number that it can drive
    needs: str = ""  # options of the co-simulation that it is made for
    use: str = ""  # when to choose it
    settings: Settings = lambda _: (ProcessConfig(), LearningConfig())  # of process and learning
    moves: bool = False  # whether it uses observed moves
    through: Callable[[Scenario], bool] = lambda _: False  # whether these drive through cells
    most_robots: int = 10**6
    require: Callable[[Scenario], object] = lambda _: None  # refuses boards that are too large
    update: Callable[..., None] = q_learning  # see `learner`
    tables: int = 1  # of each robot
    ahead: bool = False  # whether robots draw their next action before they learn from a move
    compute: Callable[[PolicyConfig], GreedyPolicy] | None = None  # None if it is learnt
    version: int = 0  # of what computes it

    def check(self, board: Scenario, process: ProcessConfig | None = None) -> None:
        """Refuse a board that it cannot drive on, before anything is observed or calibrated.

        `process` is by default that of its settings.
        """
        if board.robots > self.most_robots:
            raise UserError(
                f"method {self.name} drives at most {self.most_robots} robots, and scenario "
                f"{board.name} has {board.robots}; choose a method that learns"
            )
        self.require(board)
        tables = build_process(board, process or self.settings(board)[0])
        if self.moves:
            optimum.require_paths_alone(tables)

    def with_settings(
        self, board: Scenario, given: Mapping[str, Any]
    ) -> tuple[ProcessConfig, LearningConfig]:
        """Return its settings on a board with some of their fields replaced, by name."""
        process, learning = self.settings(board)
        known = [field.name for record in (process, learning) for field in fields(record)]
        require_names("train: setting ", given, known)
        learnt = {name: given[name] for name in given if hasattr(learning, name)}
        if learnt and self.compute is not None:
            raise _without_effect(min(learnt), self, "it is computed, not trained")
        if others := {name: given[name] for name in given if name not in learnt}:
            process = replace(process, **others)
        return process, replace(learning, **learnt)

    @property
    def own(self) -> bool:
        """Whether it is a user's: what it makes is kept for no other process."""
        return self.name not in get_args(MethodName) or METHODS.get(self.name) is not self

    @property
    def facts(self) -> dict[str, str]:
        """Return the facts by which a user chooses a method."""
        return {name: getattr(self, name) for name in ("robots", "how", "needs", "use")}


def _on_moves(scenario: Scenario) -> tuple[ProcessConfig, LearningConfig]:
    # Chosen on the observed moves: a learning rate three times the paper's, and a collision
    # that costs more than any detour.
    features = ("x", "y", "h") if scenario.robots == 1 else ("x", "y", "d", "g", "b")
    process = ProcessConfig(goal_reward=300.0, features=features)
    return process, LearningConfig(episodes=1_500_000, eta=0.03)


def _features(*first: Any, partner: bool) -> Settings:
    """Return the settings of computed policies with these features."""

    def settings(scenario: Scenario) -> tuple[ProcessConfig, LearningConfig]:
        last = ("p",) if partner and scenario.robots > 1 else ()
        return ProcessConfig(features=("x", "y", *first, *last)), LearningConfig()

    return settings


def _shortest(config: PolicyConfig) -> GreedyPolicy:
    process = config.build()
    return table_policy(config, *optimum.computed_tables(process))


def _fastest(config: PolicyConfig) -> GreedyPolicy:
    assert config.moves is not None
    if config.scenario.robots > 1:
        return PairPolicy.computed(config)
    process = config.build()
    return table_policy(config, *fastest_tables(process, config.moves))


METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        Method(
            "paper",
            "Q-learning on the grid (Section V of the paper)",
            use="default for one robot and for two; its trainings differ",
        ),
        Method(
            "double_q",
            "double Q-learning on the grid (of the paper's sequel)",
            use="where Q-learning overestimates",
            update=double_q,
            tables=2,
        ),
        Method(
            "moves",
            "Q-learning on moves observed in the co-simulation",
            use="fewest failures; default with obstacles, on large boards and for swarms",
            settings=_on_moves,
            moves=True,
        ),
        Method(
            "shortest",
            "computed: Dijkstra's algorithm over the joint grid, by path",
            "1, 2",
            use="bound of the path",
            settings=_features(partner=True),
            compute=_shortest,
            version=optimum.VERSION,
        ),
        Method(
            "fastest",
            "computed: value iteration on observed moves",
            "1, 2",
            "--through (2 robots)",
            "least time",
            _features("h", partner=True),
            moves=True,
            through=lambda scenario: scenario.robots > 1,
            most_robots=2,
            compute=_fastest,
            version=pair.VERSION,
        ),
        Method(
            "planned",
            "computed while driving: paths in space and time",
            "1 to 8",
            use="default for 3 to 8 robots",
            settings=_features("h", partner=False),
            moves=True,
            through=lambda _: True,
            require=require_plannable,
            compute=GroupPolicy.computed,
            version=group.VERSION,
        ),
    )
}


def learner(
    *, tables: int = 1, ahead: bool = True, **facts: Any
) -> Callable[[Callable[..., None]], Method]:
    """Register a rule of tabular learning on the grid as a method, which `train` and `study` take.

    A decorator that returns the method.
    The rule `(q, s, a, reward, discount, s_next, a_next, eta, coin)` updates the tables `q`
    (tables, states, 8) of one robot after a move, in code that numba compiles. `discount` is γ, and
    0 at the end of an episode; `a_next` is the action that the robot will take in `s_next`, greedy
    or random; `coin` is a random uint64, or 0 with one table. Robots act by the sum of the tables.

    Args:
        tables: of each robot, in `q`.
        ahead: whether a robot draws its next action before it learns; else `a_next` is the greedy
            one, which is all that Q-learning needs, and training is faster.
        facts: further fields of `Method`: `settings`, `most_robots`, `robots`, `needs` and `use`.
    """
    require_names("learner: ", facts, ("tables", "ahead", *_FACTS))
    kind = Annotated[int, Meta(ge=1, le=_MAX_TABLES)]
    facts["tables"] = validate_argument("learner: tables", tables, kind)
    facts["ahead"] = validate_argument("learner: ahead", ahead, bool)
    return lambda update: _registered(update, update=update, **facts)


def computed(**facts: Any) -> Callable[[Callable[[Process], np.ndarray]], Method]:
    """Register a function from the decision process to (N, states, 8) action values: a decorator.

    `facts` are further fields of `Method`, such as `settings` with features or `most_robots`.
    """
    require_names("computed: ", facts, (*_FACTS, "version"))
    return lambda function: _registered(function, compute=partial(_computed, function), **facts)


def _computed(function: Callable[[Process], np.ndarray], config: PolicyConfig) -> GreedyPolicy:
    """Return the policy of a user's action values; they must be finite float32."""
    process, name = config.build(), config.method
    given = _asked(f"method {name}", function, process)
    shape = (config.scenario.robots, process.state_count, DIRECTION_COUNT)
    values = numbers(given, shape)
    if values is None or np.abs(values).max() > np.finfo(np.float32).max:
        raise UserError(
            f"method {name} returned {shorten(given)} of shape {np.shape(given)}; expected finite "
            f"numbers of shape {shape}: robots, states of the process, directions"
        )
    return table_policy(config, values, np.ones(shape[:2], dtype=bool))


def _asked(what: str, function: Callable, argument: Any) -> Any:
    """Return what a user's function says; its failures become a UserError."""
    try:
        return function(argument)
    except (Exception, SystemExit) as error:  # whatever a user's code does
        raise failure(what, error) from error


def _registered(
    function: Callable, *, settings: Callable[[Scenario], Any] | None = None, **fields: Any
) -> Method:
    how = (function.__doc__ or "of a user").strip().partition("\n")[0]
    name = f"{function.__module__}:{function.__name__}"

    def checked(scenario: Scenario) -> tuple[ProcessConfig, LearningConfig]:
        assert settings is not None
        given = _asked(f"settings of method {name}", settings, scenario)
        try:
            process, learning = given
        except (TypeError, ValueError):
            process = learning = None
        if not (isinstance(process, ProcessConfig) and isinstance(learning, LearningConfig)):
            raise UserError(
                f"settings of method {name} returned {shorten(given)}; expected a ProcessConfig "
                "and a LearningConfig"
            )
        return process, learning

    if settings is not None:
        fields["settings"] = checked
    METHODS[name] = method = Method(name, how, **fields)
    return method


def find_method(name: "str | Method") -> Method:
    """Return a method by its name, which may be the "module:function" of a user."""
    if isinstance(name, str) and name not in METHODS and ":" in name:
        found = imported("method", name, "a method that is registered")
    else:
        found = METHODS.get(name) if isinstance(name, str) else name
    if not isinstance(found, Method):
        raise unknown("method", str(name), METHODS)
    return found


def best_method(scenario: Scenario) -> str:
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
    method: str | Method | None,
    scenario: str | Path | Scenario,
    seed: int = 0,
    *,
    options: Physics = _PAPER,
    world: AnyWorld = None,
    process: ProcessConfig | None = None,
    learning: LearningConfig | None = None,
    episodes: int | None = None,
    moves: ObservedMoves | None = None,
    worlds: WorldRange | None = None,
    alone: bool = False,
    progress: Progress = silent,
) -> PolicyConfig:
    """Return the configuration of a policy; observe moves that are missing.

    All that make policies call this: board, machine and motors mean the same everywhere.

    Args:
        method: by default the best one for the board.
        scenario, world: see `Physics.board`; the world's obstacles are all that it learns of it.
        seed: of training; a computed policy has none.
        options: of them the machine and its motors decide the size of the robots, and the moves of
            methods that use some.
        process, learning: settings, by default those of the method.
        episodes: of training, the method's own number by default.
        moves: observed before.
        worlds: ranges of the worlds that moves are observed in; by default that of the paper.
        alone: whether the options are for this policy alone, and refused where they change nothing.
    """
    board, _ = options.board(scenario, world)
    method = find_method(best_method(board) if method is None else method)
    if worlds is not None and (moves or not method.moves or method.compute is not None):
        raise _without_effect("worlds", method, "it does not learn from moves that it observes")
    if alone:
        _refuse_without_effect(method, board, scenario, seed, options, world)
    if method.compute is not None and episodes is not None:
        raise UserError(
            f"method {method.name} is computed, not trained; leave out the number of episodes, or "
            "choose a method that learns, such as moves"
        )
    usual_process, usual_learning = method.settings(board)
    process, learning = process or usual_process, learning or usual_learning
    method.check(board, process)
    if method.moves:
        machine = options.machine
        fmu = machine.fmu(progress)
        config = with_motor(machine.config().sized(board.diameter_m), fmu)
        if moves is None:
            config = calibrated(config, fmu, progress, slower=True)
            config = config.merged(DecisionOptions(through=method.through(board)).tree())
            worlds = None if worlds is None else checked_ranges(worlds, config)
            moves = cached_moves(config, fmu, progress, worlds, board.cell_m)
        elif moves.foreign_to(config):
            raise UserError(
                f"moves = those of machine {moves.machine} do not fit {config.preset} "
                f"({fmu.name}), {1e3 * board.diameter_m:g} mm large; give the preset and motor "
                "options that they were observed with, or observe others with `minirobots moves`"
            )
    if episodes is not None:
        learning = replace(learning, episodes=episodes)
    own: dict[str, Any] = {}
    if method.compute is not None:
        seed, own = 0, {"kernel_version": f"{method.name} {method.version}"}
    return PolicyConfig(board, process, learning, Seed.of(seed), moves, method.name, **own)


def _refuse_without_effect(
    method: Method,
    board: Scenario,
    scenario: str | Path | Scenario,
    seed: int,
    options: Physics,
    world: AnyWorld,
) -> None:
    """Refuse what a user gives for a policy alone and does not change it; see `method_config`."""
    none = "it uses no moves; moves, fastest and planned do"
    same = board == find_in_world(scenario, world)[0]  # as of the paper's machine
    if seed and method.compute is not None:
        raise _without_effect("seed", method, "it is computed, and nothing is drawn")
    if world is not None and board == options.board(scenario)[0]:
        raise _without_effect("world", method, "a policy learns its obstacles, and it has none")
    if options.preset != PAPER and same and not method.moves:
        raise _without_effect("preset", method, f"robots have the same size, and {none}")
    for name in ("motor_fmu", "motor_parameters"):
        if getattr(options, name) and not method.moves:
            raise _without_effect(name, method, none)


def _without_effect(name: str, method: Method, reason: str) -> ConfigError:
    return ConfigError(f"{name} has no effect on method {method.name}: {reason}; leave it out")

"""Learning: decision process, Q-learning, policies and what they achieve.

>>> import agent
>>> policy = agent.train("1a", method="paper", episodes=20_000)
>>> policy.config.scenario.name
'1a'
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.base.arguments import validate_argument
from cosim.base.command import Seed
from cosim.base.errors import UserError
from cosim.base.progress import Progress, automatic, showing, silent
from cosim.model.preset import PAPER
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario

if TYPE_CHECKING:
    from agent.mdp.greedy import GreedyPolicy
    from agent.moves.worlds import WorldRange
    from agent.training.methods import Method
    from cosim.model.preset import Preset
    from cosim.simulation.options import AnyWorld

__all__ = ["Policy", "UserError", "load", "methods", "train"]


def methods() -> tuple[str, ...]:
    """Names of the methods that make policies; see `agent.training.methods`."""
    from agent.training.methods import METHODS  # noqa: PLC0415 - numba is slow to import

    return tuple(METHODS)


@showing
def train(
    scenario: str | Path | Scenario,
    *,
    method: "str | Method | None" = None,
    seed: int = 0,
    episodes: int | None = None,
    motor_fmu: str | Path | None = None,
    motor_parameters: Mapping[str, float] = {},
    worlds: "WorldRange | None" = None,
    preset: "str | Path | Preset" = PAPER,
    world: "AnyWorld" = None,
    again: bool = False,
    progress: Progress | None = automatic,
    **settings: Any,
) -> "GreedyPolicy":
    """Train a policy, or find it in the cache if this configuration was trained before.

    That of a `Method` of yours is made in every call: its code may have changed.

    >>> import minirobots as mr
    >>> mr.train("1a", method="paper", episodes=20_000, progress=None)
    Policy(scenario 1a, 20000 episodes on the grid)
    >>> mr.train("1a", method="paper", episodes=20_000, gamma=0.95, eta=0.03, progress=None)
    Policy(scenario 1a, 20000 episodes on the grid)

    Args:
        scenario: name of a built-in scenario, scenario file (.toml) or record.
        method: one of `methods()`, or a `Method` of yours; by default "paper" for one robot or two
            on a board of up to 1000 cells without obstacles, "planned" for three to eight, else
            "moves".
        seed: of training.
        episodes: of training, the method's own number by default.
        motor_fmu: motor FMU for observing moves, in methods that use moves; by default
            the built-in one.
        motor_parameters: of the motor FMU while its moves are observed, set through FMI, in its
            units, such as {"J": 5e-9}.
        preset: machine, by name or file: its robots' size, and in methods that use moves what
            these do.
        world: world whose obstacles the policy learns, as file, record or dict of its fields; by
            default that of the scenario file.
        worlds: ranges from which every walk of the observed moves draws its world, such as
            `agent.envs.ROBUST_WORLDS`; only for the method "moves".
        again: train even if the policy is there.
        progress: receives what is calibrated, observed and trained; by default it is shown on
            stderr if the call takes more than two seconds. None shows nothing.
        settings: in place of those of the method: fields of `LearningConfig` (`eta`, `gamma`,
            `epsilon` and so on, of methods that learn) and of `ProcessConfig` (`features`,
            `approach_coefficient` and so on), as in `minirobots train`.

    Returns:
        The policy: `act(observation)`, `save(path)` and what it was trained with, `config`.

    Raises:
        UserError: the scenario, the machine or the method is unknown, the seed is negative, an
            argument has no effect on the policy, or the FMU cannot be used.
    """
    from cosim.simulation.ahead import compiling_ahead  # noqa: PLC0415 - numba is slow to import
    from cosim.simulation.options import Physics  # noqa: PLC0415 - with tyro

    motors: Any = {"motor_fmu": motor_fmu, "motor_parameters": motor_parameters}
    given: Any = preset  # a record, too, see `Physics`
    options = Physics(preset=given, **motors)
    board, _ = options.board(scenario, world)
    with compiling_ahead(board.robots):  # most policies are simulated next
        from agent.training.methods import best_method, find_method, method_config  # noqa: PLC0415
        from agent.training.store import find_or_make  # noqa: PLC0415

        name = best_method(board) if method is None else method
        chosen = find_method(validate_argument("method", name, str | type(name)))
        process, learning = chosen.with_settings(board, settings)
        config = method_config(
            chosen,
            scenario,
            validate_argument("seed", seed, Seed),
            options=options,
            world=world,
            process=process,
            learning=learning,
            episodes=validate_argument("episodes", episodes, int | None),
            worlds=worlds,
            alone=True,
            progress=progress or silent,
        )
        again = validate_argument("again", again, bool)
        return find_or_make(config, chosen, again=again, progress=progress or silent)[0]


def load(path: str | Path, scenario: str | Path | Scenario | None = None) -> "GreedyPolicy":
    """Read a policy from its file.

    >>> import minirobots as mr
    >>> mr.train("1a", method="shortest", progress=None).save("policy.npz")
    >>> mr.load("policy.npz").config.scenario.name
    '1a'

    Args:
        path: of the .npz file that a policy's `save` or a run has written.
        scenario: name, file or record; if given, only a policy trained on it is accepted.

    Raises:
        UserError: there is no such file, it is no policy, or one of another scenario.
    """
    from agent.training.policy import load_policy  # noqa: PLC0415 - numba is slow to import

    only = None if scenario is None else find_scenario(scenario)
    return load_policy(validate_argument("path", path, Path), only)


def __getattr__(name: str) -> Any:
    if name == "Policy":
        from agent.training.policy import Policy  # noqa: PLC0415 - numba is slow to import

        return Policy
    raise AttributeError(f"module 'agent' has no attribute '{name}'")

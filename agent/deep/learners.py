"""Training of a network by one of the learners: `ippo`, `mappo` (`agent.deep.ppo`) or `ddqn`.

`ddqn` is `agent.deep.ddqn`. Only this module imports them: they need the extra `deep`.
"""

import time
from collections.abc import Callable

import numpy as np

from agent.deep.ddqn import DoubleQ
from agent.deep.learning_grid import SHAPING, DrawnTargets, LearningGrid, with_drawn_targets
from agent.deep.policy import NetworkConfig, NetworkPolicy
from agent.deep.ppo import Ppo
from agent.mdp.exact import Milestone, some_starts
from agent.mdp.readings import build_process
from cosim.base.progress import Progress
from cosim.model.outcome import Outcome

BOARDS = 256
ROUND = 40_000  # rows stepped between two evaluations, at least
OTHERS = 9  # drawn targets of an evaluation
WATCHED = 1000  # starts of an evaluation, at most


def train(
    config: NetworkConfig,
    progress: Progress,
    watch: Callable[[Milestone], None],
    enough: float | None = None,
) -> NetworkPolicy:
    """Train a network on the grid; the best of the evaluated ones is kept.

    Args:
        config: what it is trained with; `steps` are those of all robots together, at least.
        progress: receives the moves made.
        watch: receives every evaluation, over at most `WATCHED` starts, see `some_starts`; of a
            network that finds any target, of the scenario and `OTHERS` with drawn targets.
        enough: success at which training ends before its last step, if at any.
    """
    scenario, steps, seed = config.scenario, config.steps, config.seed.entropy
    shaping = SHAPING[config.algorithm]._replace(process=config.process)
    grid = DrawnTargets if config.any_target else LearningGrid
    world = grid(scenario, BOARDS, seed, shaping)
    if config.algorithm == "ddqn":
        learner = DoubleQ(world, seed, steps)
    else:
        learner = Ppo(world, scenario, seed, central=config.algorithm == "mappo")
    boards, rng = [scenario], np.random.default_rng(seed)
    if config.any_target:
        boards += [with_drawn_targets(scenario, config.process, rng) for _ in range(OTHERS)]
    watched = WATCHED // len(boards)
    starts = [some_starts(build_process(board, config.process), watched) for board in boards]
    began = time.perf_counter()
    best: NetworkPolicy | None = None
    most, done = -1.0, 0
    while done < steps:
        for _ in range(-(-ROUND // (BOARDS * scenario.robots))):
            done += learner.advance(world)
        policy = NetworkPolicy(config, learner.network(), world.episodes)
        rates = [
            policy.in_scenario(board).evaluate(those).rate(Outcome.SUCCESS)
            for board, those in zip(boards, starts, strict=True)
        ]
        success = float(np.mean(rates))
        watch(Milestone(done, time.perf_counter() - began, success))
        progress("training", min(done, steps), steps, f"success {100.0 * success:.1f} %")
        if success > most:
            best, most = policy, success
        if enough is not None and success >= enough:
            break
    assert best is not None
    return best

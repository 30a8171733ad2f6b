"""Training of a network by one of the learners: `ippo`, `mappo` (`agent.deep.ppo`) or `ddqn`.

`ddqn` is `agent.deep.ddqn`. Only this module imports them: they need the extra `deep`.
"""

import time
from collections.abc import Callable

from agent.deep.ddqn import DoubleQ
from agent.deep.policy import NetworkConfig, NetworkPolicy
from agent.deep.ppo import Ppo
from agent.deep.world import SHAPING, LearningGrid
from agent.mdp.exact import Milestone, some_starts
from agent.mdp.readings import build_process
from cosim.base.progress import Progress
from cosim.model.outcome import Outcome

BOARDS = 256
ROUND = 40_000  # rows stepped between two evaluations, at least
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
        watch: receives every evaluation, over at most `WATCHED` starts, see `some_starts`.
        enough: success at which training ends before its last step, if at any.
    """
    scenario, steps, seed = config.scenario, config.steps, config.seed.entropy
    shaping = SHAPING[config.algorithm]._replace(process=config.process)
    world = LearningGrid(scenario, BOARDS, seed, shaping)
    if config.algorithm == "ddqn":
        learner = DoubleQ(world, seed, steps)
    else:
        learner = Ppo(world, scenario, seed, central=config.algorithm == "mappo")
    starts = some_starts(build_process(scenario, config.process), WATCHED)
    began = time.perf_counter()
    best: NetworkPolicy | None = None
    most, done = -1.0, 0
    while done < steps:
        for _ in range(-(-ROUND // (BOARDS * scenario.robots))):
            done += learner.advance(world)
        policy = NetworkPolicy(config, learner.network(), world.episodes)
        success = policy.evaluate(starts).rate(Outcome.SUCCESS)
        watch(Milestone(done, time.perf_counter() - began, success))
        progress("training", min(done, steps), steps, f"success {100.0 * success:.1f} %")
        if success > most:
            best, most = policy, success
        if enough is not None and success >= enough:
            break
    assert best is not None
    return best

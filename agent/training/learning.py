"""Parts of a training run: its schedule, and the state between two episodes.

The compiled loop over a `TrainingState` is `agent.training.qlearning`, or
`agent.training.moves_qlearning` for moves that last; files, progress bars and policies are
elsewhere.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from agent.mdp.interpretations import Process
from agent.mdp.rng import probability_threshold, seeded_state
from agent.training.rules import RECORDS, q_learning
from agent.training.settings import LearningConfig
from cosim.onboard.features import DIRECTION_COUNT

VERSION = 1  # of trained policies and learning curves: raise it when their bits change

# Maps are kept of boards with up to this many cells times robots: 10 MB.
MAX_MAPPED_CELLS = 100_000


class Learning(NamedTuple):
    """A `LearningConfig` for the kernel."""

    eta: np.ndarray  # float32, learning rate of each block of episodes
    gamma: np.float32
    epsilon_thresholds: np.ndarray  # uint64, exploration threshold of each block of episodes
    block: int  # episodes of constant epsilon and eta
    rule: Any  # see `agent.training.rules.compiled`
    # 0, 1, ... for the tables of a robot; a tuple, so that the compiler knows their number
    tables: tuple[int, ...]
    ahead: bool  # whether a robot draws its next action before it learns from a move
    log_episodes: int  # per point of the learning curves
    log_window: int  # last episodes of a point that count


# Columns of a learning-curve row: sums over the window's episodes.
EPISODES, SUCCESSES, PATH_CELLS, STEPS, RETURNS = 0, 1, 2, 3, 4  # RETURNS and after: one per robot


@dataclass
class TrainingState:
    """Everything a training run is made of between two episodes."""

    q: np.ndarray  # (tables, N, states, 8) float32, Q tables, see `Method.tables`
    visits: np.ndarray  # (N, states) uint32, how often each robot decided in each state
    random: np.ndarray  # (1,) uint64, generator state
    # (points, RETURNS + N) float64, sums over the window of each point: episodes, successes, path
    # length in cells (mean over robots, successes only), moves (the same), return of each robot
    curve: np.ndarray
    # (G, 3) float64, exact evaluations during training: success rate, path length in cells, moves
    greedy: np.ndarray
    # (S, N, 3, columns, rows) float32, value, greedy direction and visits of each cell
    # (`cosim.recording.series`) after the evaluations of `map_points`
    maps: np.ndarray
    episode: int = 0  # episodes done
    agent_steps: int = 0  # decisions of all robots so far

    @property
    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return what the kernels update."""
        return self.q, self.visits, self.random, self.curve


def epsilon_of_episodes(config: LearningConfig, episodes: np.ndarray) -> np.ndarray:
    """Exploration probability in each of the given episodes, float64.

    Products instead of powers, so that every platform has the same bits.
    """
    blocks = -(-config.episodes // config.epsilon_episodes)
    explored = config.exploration * config.episodes
    starts = np.arange(blocks) * config.epsilon_episodes
    if config.schedule == "geometric":
        factors = np.full(blocks, config.epsilon_decay)
        factors[0] = config.epsilon
        # "coefficient of 0.999 at every 500 episodes", Section V
        epsilon = np.multiply.accumulate(factors)
    else:
        epsilon = config.epsilon * np.maximum(0.0, 1.0 - starts / max(explored, 1.0))
    return np.where(episodes < explored, epsilon[episodes // config.epsilon_episodes], 0.0)


def build_learning(
    config: LearningConfig, rule: Any = RECORDS[q_learning], tables: int = 1, *, ahead: bool = False
) -> Learning:
    """The kernel's form of a learning configuration; the rest is of the `Method`."""
    starts = np.arange(0, config.episodes, config.block)
    epsilon = epsilon_of_episodes(config, starts)
    fall = (config.eta if config.eta_end is None else config.eta_end) - config.eta
    return Learning(
        eta=(config.eta + fall * (starts / config.episodes)).astype(np.float32),
        gamma=np.float32(config.gamma),
        epsilon_thresholds=np.array([probability_threshold(e) for e in epsilon], dtype=np.uint64),
        block=config.block,
        rule=rule,
        tables=tuple(range(tables)),
        ahead=ahead,
        log_episodes=config.log_episodes,
        log_window=config.log_window,
    )


def map_points(config: LearningConfig) -> np.ndarray:
    """Indices of the greedy evaluations with maps, (S,): 1st, 2nd, 4th, 8th … and the last."""
    count = min(config.greedy_points, config.episodes)
    powers = 2 ** np.arange(count.bit_length()) - 1
    return np.unique(np.append(powers, count - 1)) if count else np.zeros(0, dtype=np.int64)


def initial_state(
    process: Process,
    config: LearningConfig,
    seed: int | np.random.SeedSequence,
    tables: int = 1,
) -> TrainingState:
    """Tables of zeros, of which a robot has `tables`, and a seeded generator."""
    robots = process.terrain.shape[0]
    points = -(-config.episodes // config.log_episodes)
    columns, rows = (size - 2 for size in process.terrain.shape[1:])
    mapped = robots * columns * rows <= MAX_MAPPED_CELLS
    moments = len(map_points(config)) if mapped else 0
    shape = (tables, robots, process.state_count, DIRECTION_COUNT)
    return TrainingState(
        q=np.zeros(shape, dtype=np.float32),
        visits=np.zeros((robots, process.state_count), dtype=np.uint32),
        random=seeded_state(seed),
        curve=np.zeros((points, RETURNS + robots)),
        greedy=np.full((min(config.greedy_points, config.episodes), 3), np.nan),
        maps=np.zeros((moments, robots, 3, columns, rows), dtype=np.float32),
    )

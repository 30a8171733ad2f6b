"""Independent Q-learning and double Q-learning of N robots: Eq. (7) as one compiled loop.

The loop advances a `TrainingState` by any number of episodes; the state holds everything, the
generator included, so that cutting a run into chunks or resuming it cannot change a bit. Files,
progress bars and policies are elsewhere.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from agent.grid import (
    COLUMN_COUNT,
    MOVING,
    RUNNING,
    STATUS,
    SUCCESS,
    TIMEOUT,
    VX,
    VY,
    move,
    place_randomly,
    slipped,
    state_index,
)
from agent.process import Process
from agent.rng import PROBABILITY_SHIFT, next_word, probability_threshold, seeded_state
from cosim.errors import UserError
from cosim.features import DIRECTION_COUNT
from cosim.jit import inlined, kernel

# Maps are kept of boards with up to this many cells times robots: 10 MB.
MAX_MAPPED_CELLS = 100_000
KERNEL_VERSION = 1  # raise it when a change alters the bits of a trained table

ACTION_BITS = np.uint64(DIRECTION_COUNT - 1)
_ONE = np.uint64(1)
SQRT_2 = np.sqrt(2.0)


class LearningError(UserError):
    """A learning configuration that cannot be used; the message names the field."""


@dataclass(frozen=True)
class LearningConfig:
    """Numbers of Section V and what the paper leaves open about learning."""

    episodes: int = 5_000_000
    """Training episodes (Section V)."""
    eta: float = 0.01
    """Learning rate of Eq. (7) (Section V; Section III says 0.001)."""
    gamma: float = 0.99
    """Discount rate (Section V)."""
    epsilon: float = 0.9
    """Probability of a random action at the start (Section V)."""
    epsilon_decay: float = 0.999
    """Factor on epsilon every `epsilon_episodes` episodes (Section V)."""
    epsilon_episodes: int = 500
    """Episodes between two reductions of epsilon (Section V)."""
    exploration: float = 0.6
    """Share of the episodes with exploration; epsilon is 0 afterwards (Section V)."""
    schedule: Literal["geometric", "linear"] = "geometric"
    """Reduction by the factor (assumed), or linear to 0 at the end of exploration."""
    algorithm: Literal["q", "double_q"] = "q"
    """Q-learning of Eq. (7), or double Q-learning (two tables per robot)."""
    log_episodes: int = 1000
    """Episodes between two points of the learning curves."""
    log_window: int = 100
    """Last episodes that a point of the learning curves is the mean of (Section V.B: 100)."""
    greedy_points: int = 50
    """Exact evaluations of the greedy policy during training, evenly spread; 0 for none."""

    def __post_init__(self) -> None:
        checks = {
            "episodes": self.episodes >= 1,
            "eta": 0 < self.eta <= 1,
            "gamma": 0 <= self.gamma <= 1,
            "epsilon": 0 <= self.epsilon <= 1,
            "epsilon_decay": 0 <= self.epsilon_decay <= 1,
            "epsilon_episodes": self.epsilon_episodes >= 1,
            "exploration": 0 <= self.exploration <= 1,
            "log_episodes": self.log_episodes >= 1,
            "log_window": 1 <= self.log_window <= self.log_episodes,
            "greedy_points": self.greedy_points >= 0,
        }
        for name, valid in checks.items():
            if not valid:
                raise LearningError(
                    f"learning: {name} = {getattr(self, name)} is not allowed; see its "
                    "description in `python -m agent.train --help`"
                )


class Learning(NamedTuple):
    """A `LearningConfig` for the kernel.

    Attributes:
        eta: float32.
        gamma: float32.
        epsilon_thresholds: uint64, exploration threshold of each block of episodes.
        epsilon_episodes: episodes per block.
        double_q: whether there are two tables per robot.
        log_episodes: episodes per point of the learning curves.
        log_window: last episodes of a point that count.
    """

    eta: np.float32
    gamma: np.float32
    epsilon_thresholds: np.ndarray
    epsilon_episodes: int
    double_q: bool
    log_episodes: int
    log_window: int


# Columns of a learning-curve row: sums over the window's episodes.
EPISODES, SUCCESSES, PATH_CELLS, STEPS, RETURNS = 0, 1, 2, 3, 4  # RETURNS and after: one per robot


@dataclass
class TrainingState:
    """Everything a training run is made of between two episodes.

    Attributes:
        q: (tables, N, states, 8) float32, Q tables; two tables for double Q-learning.
        visits: (N, states) uint32, how often each robot decided in each state.
        random: (1,) uint64, generator state.
        curve: (points, RETURNS + N) float64, sums over the window of each point: episodes,
            successes, path length in cells (mean over robots, successes only), moves (the same),
            return of each robot.
        greedy: (G, 3) float64, exact evaluations during training: success rate, path length in
            cells, moves.
        maps: (S, N, 3, columns, rows) float32, value, greedy direction and visits of each cell
            (`cosim.policy_map`) after the evaluations of `map_points`.
        episode: episodes done.
        agent_steps: decisions of all robots so far.
    """

    q: np.ndarray
    visits: np.ndarray
    random: np.ndarray
    curve: np.ndarray
    greedy: np.ndarray
    maps: np.ndarray
    episode: int = 0
    agent_steps: int = 0


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


def build_learning(config: LearningConfig) -> Learning:
    """The kernel's form of a learning configuration.

    A block of constant epsilon never crosses the end of exploration: blocks are as long as the
    greatest common divisor of the schedule's period and that end.
    """
    explored = int(np.ceil(config.exploration * config.episodes))
    block = int(np.gcd(config.epsilon_episodes, explored)) if explored else config.epsilon_episodes
    epsilon = epsilon_of_episodes(config, np.arange(0, config.episodes, block))
    return Learning(
        eta=np.float32(config.eta),
        gamma=np.float32(config.gamma),
        epsilon_thresholds=np.array([probability_threshold(e) for e in epsilon], dtype=np.uint64),
        epsilon_episodes=block,
        double_q=config.algorithm == "double_q",
        log_episodes=config.log_episodes,
        log_window=config.log_window,
    )


def map_points(config: LearningConfig) -> np.ndarray:
    """Indices of the greedy evaluations with maps, (S,): 1st, 2nd, 4th, 8th … and the last."""
    count = min(config.greedy_points, config.episodes)
    powers = 2 ** np.arange(count.bit_length()) - 1
    return np.unique(np.append(powers, count - 1)) if count else np.zeros(0, dtype=np.int64)


def initial_state(
    process: Process, config: LearningConfig, seed: int | np.random.SeedSequence
) -> TrainingState:
    """Tables of zeros and a seeded generator."""
    robots = process.terrain.shape[0]
    tables = 2 if config.algorithm == "double_q" else 1
    points = -(-config.episodes // config.log_episodes)
    columns, rows = (size - 2 for size in process.terrain.shape[1:])
    moments = len(map_points(config)) if robots * columns * rows <= MAX_MAPPED_CELLS else 0
    return TrainingState(
        q=np.zeros((tables, robots, process.state_count, DIRECTION_COUNT), dtype=np.float32),
        visits=np.zeros((robots, process.state_count), dtype=np.uint32),
        random=seeded_state(seed),
        curve=np.zeros((points, RETURNS + robots)),
        greedy=np.full((min(config.greedy_points, config.episodes), 3), np.nan),
        maps=np.zeros((moments, robots, 3, columns, rows), dtype=np.float32),
    )


@inlined
def largest(values: np.ndarray) -> tuple[int, np.float32]:
    """Index of the largest of eight values, the lowest of equals (Eq. 6), and that value."""
    # a tournament of three rounds instead of a chain of seven comparisons: it is what limits speed
    a, va = (1, values[1]) if values[1] > values[0] else (0, values[0])
    b, vb = (3, values[3]) if values[3] > values[2] else (2, values[2])
    c, vc = (5, values[5]) if values[5] > values[4] else (4, values[4])
    d, vd = (7, values[7]) if values[7] > values[6] else (6, values[6])
    a, va = (b, vb) if vb > va else (a, va)
    c, vc = (d, vd) if vd > vc else (c, vc)
    return (c, vc) if vc > va else (a, va)


@inlined
def _best_of_sum(q: np.ndarray, i: int, s: np.uint64) -> int:
    """The same over the sum of the two tables of double Q-learning."""
    action = 0
    best = q[0, i, s, 0] + q[1, i, s, 0]
    for k in range(1, DIRECTION_COUNT):
        value = q[0, i, s, k] + q[1, i, s, k]
        if value > best:
            best = value
            action = k
    return action


@kernel
def _run_episodes(
    process: Process,
    learning: Learning,
    q: np.ndarray,
    visits: np.ndarray,
    random: np.ndarray,
    curve: np.ndarray,
    first: int,
    last: int,
) -> int:
    """Train over episodes [first, last); all arrays are updated. Returns the agent steps."""
    n = len(process.start_offsets) - 1
    world = np.empty((n, COLUMN_COUNT), dtype=np.int64)
    cells = np.empty((n, 2), dtype=np.int64)
    chosen = np.empty(n, dtype=np.int64)
    executed = np.empty(n, dtype=np.int64)
    state = np.empty(n, dtype=np.uint64)
    greedy = np.empty(n, dtype=np.int64)
    moved = np.empty(n, dtype=np.bool_)
    rewards = np.empty(n, dtype=np.float32)
    returns = np.empty(n, dtype=np.float64)
    eta, gamma = learning.eta, learning.gamma
    penalty = -process.goal_reward
    slips = process.slip_threshold > np.uint64(0)
    agent_steps = 0
    for episode in range(first, last):
        threshold = learning.epsilon_thresholds[episode // learning.epsilon_episodes]
        explores = threshold > np.uint64(0)
        place_randomly(process, world, cells, random)
        for i in range(n):
            returns[i] = 0.0
            state[i] = state_index(process, world, i)
            if learning.double_q:
                greedy[i] = _best_of_sum(q, i, state[i])
            else:
                greedy[i], _ = largest(q[0, i, state[i]])
        moves = 0
        diagonal_moves = 0
        outcome = RUNNING
        step = 0
        while outcome == RUNNING:
            step += 1
            for i in range(n):
                moved[i] = world[i, STATUS] == MOVING
                if moved[i]:
                    chosen[i] = greedy[i]
                    if explores:
                        # no branch on what cannot be predicted: it would cost more than the draw
                        word = next_word(random)
                        explored = np.int64(word & ACTION_BITS)
                        chosen[i] = (
                            explored if (word >> PROBABILITY_SHIFT) < threshold else greedy[i]
                        )
                    executed[i] = chosen[i]
                    if slips:
                        executed[i] = slipped(process, chosen[i], random)
            outcome = move(process, world, executed, rewards)
            failed = outcome not in (RUNNING, SUCCESS)
            if outcome == RUNNING and step == process.step_limit:
                outcome = TIMEOUT  # a cut, not an end: the update still bootstraps
            for i in range(n):
                if not moved[i]:
                    continue
                moves += 1
                diagonal_moves += world[i, VX] & world[i, VY] & 1
                returns[i] += rewards[i]
                s, a = state[i], chosen[i]
                visits[i, s] += np.uint32(1)
                updated = 0
                if learning.double_q:
                    updated = np.int64(next_word(random) & _ONE)
                if world[i, STATUS] == MOVING:
                    s_next = state_index(process, world, i)
                    target = rewards[i]
                    if failed and process.partner_update == 2:
                        continue
                    if failed and process.partner_update == 1:
                        target = penalty
                        best = 0
                    else:
                        best, value = largest(q[updated, i, s_next])
                        if learning.double_q:
                            # the other table values the action that this one picks
                            value = q[1 - updated, i, s_next, best]
                        target += gamma * value
                    # Eq. (7)
                    q[updated, i, s, a] += eta * (target - q[updated, i, s, a])
                    state[i] = s_next
                    if learning.double_q:
                        greedy[i] = _best_of_sum(q, i, s_next)
                    else:
                        # the row changed after `best` was found if the features hide the move
                        greedy[i] = best if s_next != s else largest(q[0, i, s_next])[0]
                else:
                    # Eq. (7) in a terminal state
                    q[updated, i, s, a] += eta * (rewards[i] - q[updated, i, s, a])
        agent_steps += moves
        if episode % learning.log_episodes >= learning.log_episodes - learning.log_window:
            row = episode // learning.log_episodes
            curve[row, EPISODES] += 1.0
            if outcome == SUCCESS:
                curve[row, SUCCESSES] += 1.0
                straight_moves = moves - diagonal_moves
                curve[row, PATH_CELLS] += (straight_moves + SQRT_2 * diagonal_moves) / n
                curve[row, STEPS] += moves / n
            for i in range(n):
                curve[row, RETURNS + i] += returns[i]
    return agent_steps


def advance(process: Process, learning: Learning, state: TrainingState, until: int) -> None:
    """Train a state up to episode `until` on the grid, in place."""
    state.agent_steps += _run_episodes(
        process,
        learning,
        state.q,
        state.visits,
        state.random,
        state.curve,
        state.episode,
        until,
    )
    state.episode = until

"""One training run from start to end: chunks with progress, and learning curves.

The compiled loop is `agent.training.qlearning`; where results are kept is `agent.training.store`;
many runs at once are `agent.training.runs`. How a run is cut into chunks cannot change its bits.
"""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import pdist

from agent.mdp.exact import cell_map, evaluate, some_starts
from agent.mdp.optimum import require_paths_alone
from agent.mdp.readings import build_process
from agent.moves.model import MoveModel, build_model
from agent.training.learning import (
    EPISODES,
    PATH_CELLS,
    RETURNS,
    STEPS,
    SUCCESSES,
    TrainingState,
    build_learning,
    epsilon_of_episodes,
    initial_state,
    map_points,
)
from agent.training.moves_qlearning import advance_moves
from agent.training.policy import PolicyConfig
from agent.training.qlearning import advance
from agent.training.settings import LearningConfig
from cosim.base.reading import Kind, read_arrays
from cosim.base.storage import replacing
from cosim.model.outcome import Outcome

# Learning curves evaluate up to this many of the `joint_starts`, evenly spaced if there are more.
MAX_CURVE_STARTS = 5_000
CHUNK_EPISODES = 50_000  # about 0.1 s: progress moves and Ctrl-C answers


class TrainingProgress(NamedTuple):
    """Progress of a run, given to the progress callback after every chunk.

    Attributes:
        episode: episodes done.
        episodes: episodes in all.
        success: success rate at the last finished point of the learning curve; NaN before it.
        epsilon: exploration probability of the last episode.
    """

    episode: int
    episodes: int
    success: float
    epsilon: float


ProgressCallback = Callable[[TrainingProgress], None]


_FILE = Kind("file of learning curves", "train again")


class TrainingLog(NamedTuple):
    """Learning curves: K points of behaviour (exploring) and G exact greedy evaluations.

    Attributes:
        episode: (K,) int64, episodes done at each point.
        success: (K,) success rate over the last episodes (Section V.B: 100) before each point.
        path_length_cm: (K,) mean over robots and successful episodes; NaN without a success.
        steps: (K,) moves, the same means.
        returns: (K, N) mean undiscounted return of each robot.
        epsilon: (K,) exploration probability.
        greedy_episode: (G,) int64, episodes done at each greedy evaluation.
        greedy_success: (G,) exact success rate over all starts (see `MAX_CURVE_STARTS`).
        greedy_path_length_cm: (G,) mean over robots and successful starts.
        greedy_steps: (G,) moves, the same mean.
        map_episode: (S,) int64, episodes done at each moment with maps.
        maps: (S, N, 3, columns, rows) float32, value, greedy direction and visits of each cell.
    """

    episode: np.ndarray
    success: np.ndarray
    path_length_cm: np.ndarray
    steps: np.ndarray
    returns: np.ndarray
    epsilon: np.ndarray
    greedy_episode: np.ndarray
    greedy_success: np.ndarray
    greedy_path_length_cm: np.ndarray
    greedy_steps: np.ndarray
    map_episode: np.ndarray
    maps: np.ndarray

    def save(self, path: Path) -> None:
        """Write as `.npz`, whole or not at all."""
        with replacing(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, **self._asdict())

    @classmethod
    def load(cls, path: Path) -> "TrainingLog":
        """Read what `save` wrote.

        Raises:
            FileError: it is missing or damaged.
        """
        return cls(**read_arrays(path, _FILE, cls._fields))


def greedy_episodes(config: LearningConfig) -> np.ndarray:
    """(G,) int64, episodes after which the greedy policy is evaluated, the last one included."""
    points = np.arange(1, config.greedy_points + 1) * config.episodes
    return np.unique(np.maximum(points // max(config.greedy_points, 1), 1))


def move_model(config: PolicyConfig) -> MoveModel | None:
    """The moves of a configuration for the kernels; None if it is trained on the grid."""
    if config.moves is None:
        return None
    scenario = config.scenario
    # parked robots do not touch: where their targets are near, the clearance is half of the gap
    gap_m = pdist(scenario.targets).min(initial=np.inf) * scenario.cell_m
    clearance_m = min(config.process.clearance_m, 0.5 * (gap_m - scenario.diameter_m))
    contact_m = scenario.diameter_m + clearance_m
    return build_model(config.moves, contact_m / scenario.cell_m)


def run_training(task: PolicyConfig, *, progress: ProgressCallback | None = None) -> TrainingState:
    """Train from nothing to the last episode.

    Args:
        task: the configuration of the run.
        progress: called after every chunk.

    Raises:
        UserError: the scenario cannot be used with these interpretations, or a robot has a start
            without a path to its target.
    """
    config = task.learning
    process, model = build_process(task.scenario, task.process), move_model(task)
    require_paths_alone(process)
    learning = build_learning(config)
    state = initial_state(process, config, task.seed.sequence())
    evaluations = greedy_episodes(config)
    starts = some_starts(process, MAX_CURVE_STARTS)
    while state.episode < config.episodes:
        until = min(config.episodes, (state.episode // CHUNK_EPISODES + 1) * CHUNK_EPISODES)
        due = np.searchsorted(evaluations, state.episode, side="right")
        if due < len(evaluations):
            until = min(until, int(evaluations[due]))
        if model is None:
            advance(process, learning, state, until)
        else:
            advance_moves(process, model, learning, state, until)
        if until in evaluations:
            values = state.q.mean(axis=0) if len(state.q) > 1 else state.q[0]
            result = evaluate(process, values, starts)
            state.greedy[due] = (
                result.rate(Outcome.SUCCESS),
                result.mean_path_cells(),
                result.mean_steps(),
            )
            for moment in np.flatnonzero(map_points(config)[: len(state.maps)] == due):
                state.maps[moment] = [
                    cell_map(process, table, visits)
                    for table, visits in zip(values, state.visits, strict=True)
                ]
        if progress is not None:
            progress(_progress(config, state))
    return state


def _progress(config: LearningConfig, state: TrainingState) -> TrainingProgress:
    finished = state.episode // config.log_episodes
    last = state.curve[finished - 1] if finished else np.full(2, np.nan)
    epsilon = epsilon_of_episodes(config, np.array([state.episode - 1]))
    return TrainingProgress(
        state.episode,
        config.episodes,
        float(last[SUCCESSES] / last[EPISODES]),
        float(epsilon[0]),
    )


def training_log(config: LearningConfig, state: TrainingState, cell_m: float) -> TrainingLog:
    """Learning curves of a finished run; points without a counted episode are left out."""
    counted = state.curve[:, EPISODES] > 0
    curve = state.curve[counted]
    ends = np.minimum((np.flatnonzero(counted) + 1) * config.log_episodes, config.episodes)
    cell_cm = 100.0 * cell_m
    with np.errstate(invalid="ignore"):  # 0/0 where no episode of a window succeeded
        success = curve[:, SUCCESSES] / curve[:, EPISODES]
        path_length_cm = cell_cm * curve[:, PATH_CELLS] / curve[:, SUCCESSES]
        steps = curve[:, STEPS] / curve[:, SUCCESSES]
    return TrainingLog(
        episode=ends,
        success=success,
        path_length_cm=path_length_cm,
        steps=steps,
        returns=curve[:, RETURNS:] / curve[:, EPISODES, None],
        epsilon=epsilon_of_episodes(config, ends - 1),
        greedy_episode=greedy_episodes(config),
        greedy_success=state.greedy[:, 0],
        greedy_path_length_cm=cell_cm * state.greedy[:, 1],
        greedy_steps=state.greedy[:, 2],
        map_episode=greedy_episodes(config)[map_points(config)][: len(state.maps)],
        maps=state.maps,
    )

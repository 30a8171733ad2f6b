"""One training run from start to end: chunks with progress, and learning curves.

The compiled loops are `agent.training.qlearning` and `moves_qlearning`; where results are kept is
`agent.training.store`; many runs at once are `agent.training.runs`. How a run is cut into chunks
cannot change its bits.
"""

import math
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from scipy.spatial.distance import pdist

from agent.mdp.exact import cell_map, evaluate_on_grid, some_starts
from agent.mdp.optimum import require_paths_alone
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
from agent.training.methods import Method, find_method
from agent.training.moves_qlearning import advance_moves
from agent.training.policy import Policy, PolicyConfig
from agent.training.qlearning import advance
from agent.training.rules import compiled
from agent.training.settings import LearningConfig
from cosim.base.errors import UserError, failure
from cosim.base.progress import Progress, silent
from cosim.base.reading import Kind, read_arrays
from cosim.base.storage import write_arrays
from cosim.model.outcome import Outcome

# Learning curves evaluate up to this many of the `joint_starts`, evenly spaced if there are more.
MAX_CURVE_STARTS = 5_000
CHUNK_EPISODES = 50_000  # about 0.1 s: progress moves and Ctrl-C answers
_GOOD = 0.95  # assumed: success of a training that needs no remark
_RISE = 0.01  # and the rise of success over a tenth of it up to which it has converged
_FILE = Kind("file of learning curves", "train again")


class TrainingLog(NamedTuple):
    """Learning curves: K points of behaviour (exploring) and G exact greedy evaluations."""

    episode: np.ndarray  # (K,) int64, episodes done at each point
    success: np.ndarray  # (K,) rate over the last episodes (Section V.B: 100) before each point
    path_length_cm: np.ndarray  # (K,) mean over robots and successful episodes; NaN without any
    steps: np.ndarray  # (K,) moves, the same means
    returns: np.ndarray  # (K, N) mean undiscounted return of each robot
    epsilon: np.ndarray  # (K,) exploration probability
    greedy_episode: np.ndarray  # (G,) int64, episodes done at each greedy evaluation
    greedy_success: np.ndarray  # (G,) exact rate over all starts (see `MAX_CURVE_STARTS`)
    greedy_path_length_cm: np.ndarray  # (G,) mean over robots and successful starts
    greedy_steps: np.ndarray  # (G,) moves, the same mean
    map_episode: np.ndarray  # (S,) int64, episodes done at each moment with maps
    maps: np.ndarray  # (S, N, 3, columns, rows) float32, value, greedy direction, visits

    def save(self, path: Path) -> None:
        """Write as `.npz`, whole or not at all."""
        write_arrays(path, self._asdict())

    @classmethod
    def load(cls, path: Path) -> "TrainingLog":
        """Read what `save` wrote."""
        return cls(**read_arrays(path, _FILE, cls._fields))


class Learnt(msgspec.Struct, frozen=True, kw_only=True):
    """What training has achieved at its end, by its learning curves.

    Attributes:
        success: of the greedy policy on the grid, exact, or on moves as it was trained, over the
            last tenth of the episodes; None if the curves are empty.
        where: "on the grid" or "on moves".
        rise: of the success over the last tenth of the training from the tenth before.
        converged: whether that is less than a point and what chance explains.
        episodes, usual: of this training, and the method's own number.
        epsilon: probability of a random action at the end.
    """

    success: float | None
    where: str
    rise: float
    converged: bool
    episodes: int
    usual: int
    epsilon: float

    @property
    def suffices(self) -> bool:
        """Return whether nothing suggests to train longer or otherwise."""
        return self.converged and self.success is not None and self.success >= _GOOD

    def __str__(self) -> str:
        """Return it as a line of text."""
        if self.success is None:
            return f"{self.episodes} episodes, too few for a learning curve"
        how = f", with exploration (ε = {self.epsilon:.2g})" if self.epsilon else ""
        text = f"success {self.success:.1%} {self.where}{how} after {self.episodes} episodes"
        if self.suffices:
            return text
        state = "no longer rising" if self.converged else f"still rising ({self.rise:+.1%})"
        if (lacks := self.usual - self.episodes) > 0:
            return f"{text}, {state}: it lacks {lacks} of the {self.usual} that the method has"
        fix = "choose another method or other settings" if self.converged else "train longer"
        return f"{text}, {state}: {fix}"


def learnt(config: PolicyConfig, log: TrainingLog) -> Learnt:
    """Return what a training has achieved, by its learning curves."""
    exact = config.moves is None and len(log.greedy_success) > 0
    curve = log.greedy_success if exact else log.success
    tenth = max(1, len(curve) // 10)
    last, before = (
        float(np.mean(part)) if len(part) else 0.0
        for part in (curve[-tenth:], curve[-2 * tenth : -tenth])
    )
    episodes = math.inf if exact else tenth * config.learning.log_window
    chance = 2.0 * math.sqrt(2.0 * last * (1.0 - last) / episodes)
    _, usual = find_method(config.method).settings(config.scenario)
    return Learnt(
        success=(float(curve[-1]) if exact else last) if len(curve) else None,
        where="on the grid" if config.moves is None else "on moves",
        rise=last - before,
        converged=len(curve) > 1 and last - before < _RISE + chance,
        episodes=config.learning.episodes,
        usual=usual.episodes,
        epsilon=0.0 if exact or not len(curve) else float(log.epsilon[-1]),
    )


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


def learn(
    config: PolicyConfig, progress: Progress = silent, method: Method | None = None
) -> tuple[Policy, TrainingLog]:
    """Train from nothing to the last episode, without reading or writing any file.

    Args:
        method: by default the one that has the name in the configuration.
    """
    numbers, method = config.learning, method or find_method(config.method)
    process, model = config.build(), move_model(config)
    require_paths_alone(process)
    rule = compiled(method.name, method.update)
    learning = build_learning(numbers, rule, method.tables, ahead=method.ahead)
    state = initial_state(process, numbers, config.seed.sequence(), method.tables)
    evaluations = greedy_episodes(numbers)
    starts = some_starts(process, MAX_CURVE_STARTS)
    while state.episode < numbers.episodes:
        until = min(numbers.episodes, (state.episode // CHUNK_EPISODES + 1) * CHUNK_EPISODES)
        due = np.searchsorted(evaluations, state.episode, side="right")
        if due < len(evaluations):
            until = min(until, int(evaluations[due]))
        try:
            if model is None:
                advance(process, learning, state, until)
            else:
                advance_moves(process, model, learning, state, until)
        except Exception as error:  # whatever a user's rule does
            raise failure(f"the rule {method.name}", error) from error
        if not np.isfinite(state.q).all():
            raise UserError(
                f"method {method.name} has values that are not finite in its tables after "
                f"{until} episodes; correct the rule, or lower eta"
            )
        if until in evaluations:
            values = state.q.mean(axis=0) if len(state.q) > 1 else state.q[0]
            result = evaluate_on_grid(process, values, starts)
            state.greedy[due] = (
                result.rate(Outcome.SUCCESS),
                result.mean_path_cells(),
                result.mean_steps(),
            )
            for moment in np.flatnonzero(map_points(numbers)[: len(state.maps)] == due):
                state.maps[moment] = [
                    cell_map(process, table, visits)
                    for table, visits in zip(values, state.visits, strict=True)
                ]
        finished = until // numbers.log_episodes
        last = state.curve[finished - 1] if finished else np.full(2, np.nan)
        epsilon = epsilon_of_episodes(numbers, np.array([until - 1]))[0]
        success = float(last[SUCCESSES] / last[EPISODES])
        now = f"success {success:.1%}  ε {epsilon:.3f}"
        progress("training", until, numbers.episodes, now)
    policy = Policy(config, state.q, state.visits, state.random, state.episode)
    return policy, training_log(numbers, state, config.scenario.cell_m)


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

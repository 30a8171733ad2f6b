"""Builds and calls `qlearning.c`, the C reference of the training loop, for tests and benchmarks.

The reference knows the built-in scenarios and the default interpretations only.
"""

import ctypes
import subprocess
from pathlib import Path

import numpy as np

from agent.mdp.config import ProcessConfig
from agent.training.learning import Learning, TrainingState
from cosim.model.scenario import Scenario
from fmus.compiler import compiler_command

SOURCE = Path(__file__).with_name("qlearning.c")
# No contraction to fused multiply-adds: the same operations, the same bits.
FLAGS = ("-O3", "-march=native", "-ffp-contract=off", "-shared", "-fPIC", "-Wall", "-Wextra")

_INTEGER = ctypes.c_int64
_FLOAT = ctypes.c_float


def build_reference(folder: Path) -> ctypes.CDLL:
    """Compile the reference into a folder and load it."""
    library = folder / "qlearning.so"
    command = [*compiler_command(), *FLAGS, "-o", str(library), str(SOURCE), "-lm"]
    subprocess.run(command, check=True)
    loaded = ctypes.CDLL(str(library))
    loaded.train.restype = _INTEGER
    return loaded


def reference_state(scenario: Scenario, random: np.ndarray) -> TrainingState:
    """Tables of zeros with the reference's 9 features per cell, whatever the number of robots."""
    states = scenario.columns * scenario.rows * 9
    return TrainingState(
        q=np.zeros((1, scenario.robots, states, 8), dtype=np.float32),
        visits=np.zeros((scenario.robots, states), dtype=np.uint32),
        random=random.copy(),
        curve=np.empty((0, 0)),
        greedy=np.empty((0, 0)),
        maps=np.empty((0, 0)),
    )


def train_reference(
    library: ctypes.CDLL, scenario: Scenario, learning: Learning, state: TrainingState, until: int
) -> None:
    """Train a state up to episode `until` with the default interpretations, in place."""
    config = ProcessConfig()
    targets = np.array(scenario.targets, dtype=np.int32)
    starts = [np.array(cells, dtype=np.int32) for cells in scenario.starts]
    state.agent_steps += library.train(
        _INTEGER(scenario.robots),
        _pointer(targets),
        _pointer(starts[0]),
        _INTEGER(len(starts[0])),
        _pointer(starts[-1]),
        _INTEGER(len(starts[-1])),
        _FLOAT(float(learning.eta[0])),
        _FLOAT(float(learning.gamma)),
        _FLOAT(config.goal_reward),
        ctypes.c_double(config.approach_coefficient),
        _pointer(learning.epsilon_thresholds),
        _INTEGER(learning.block),
        _pointer(state.q),
        _pointer(state.visits),
        _pointer(state.random),
        _INTEGER(state.episode),
        _INTEGER(until),
    )
    state.episode = until


def _pointer(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)

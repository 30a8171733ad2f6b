"""A network as a policy: inputs from what robots see, layers in numpy arrays, and its file.

One network acts for all robots. Its forward pass is a compiled loop with one order of sums, so that
it gives the same bits everywhere, alone and in a batch. Nothing here needs what trained it.
"""

import json
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from agent.deep import NetworkAlgorithm
from agent.deep.inputs import GROUPS, Inputs, look
from agent.envs.boards import Boards
from agent.mdp.config import ProcessConfig
from agent.mdp.exact import Evaluation, joint_starts
from agent.mdp.greedy import GreedyPolicy, PolicyError
from agent.mdp.grid import STATUS, X, Y
from agent.training.policy import Seed
from cosim.base.jit import inlined, kernel
from cosim.base.provenance import digest_of
from cosim.base.reading import Kind, parsing, read_arrays
from cosim.model.outcome import RUNNING, TIMEOUT
from cosim.model.scenario import Scenario
from cosim.onboard.features import DIRECTION_COUNT, Observation
from cosim.recording.policy_map import PolicyMap

SCHEMA_VERSION = 1
_WHERE = [X, Y, STATUS]
_MEND = "train it again with `python -m agent.deep`"
_FILE = Kind("network policy", _MEND, PolicyError)


class Network(NamedTuple):
    """Weights and biases, float32; inputs D, two hidden layers of H, 8 outputs.

    Attributes:
        w1, b1: (D, H) and (H,).
        w2, b2: (H, H) and (H,).
        w3, b3: (H, 8) and (8,).
    """

    w1: np.ndarray
    b1: np.ndarray
    w2: np.ndarray
    b2: np.ndarray
    w3: np.ndarray
    b3: np.ndarray

    def fits(self, inputs: Inputs) -> bool:
        """Return whether the shapes are those of a network for these inputs."""
        hidden = len(self.b1)
        shapes = [(inputs.first[-1], hidden), (hidden,), (hidden, hidden), (hidden,)]
        shapes += [(hidden, DIRECTION_COUNT), (DIRECTION_COUNT,)]
        return [part.shape for part in self] == shapes and all(
            part.dtype == np.float32 and np.isfinite(part).all() for part in self
        )


@inlined
def _add_product(values: np.ndarray, weights: np.ndarray, total: np.ndarray) -> None:
    """Add what the positive ones of `values` contribute: a layer after the rectifier."""
    for k in range(len(values)):
        if values[k] > 0.0:
            for j in range(len(total)):
                total[j] += values[k] * weights[k, j]


@kernel
def _values(inputs: Inputs, network: Network, cells: np.ndarray, rows: int) -> np.ndarray:
    """(K, N, 8) float32, action values of all robots on (K, N, 2) int64 cells.

    Impossible moves are worth 1 less than the worst of the others.
    """
    values = np.empty((*cells.shape[:2], DIRECTION_COUNT), dtype=np.float32)
    seen = np.empty(GROUPS, dtype=np.int64)
    first, second = np.empty_like(network.b1), np.empty_like(network.b2)
    for m in range(cells.shape[0]):
        for i in range(cells.shape[1]):
            look(inputs, cells[m], i, seen)
            first[:] = network.b1
            for row in seen:
                if row >= 0:
                    for j in range(len(first)):
                        first[j] += network.w1[row, j]
            second[:] = network.b2
            _add_product(first, network.w2, second)
            values[m, i] = network.b3
            _add_product(second, network.w3, values[m, i])
            possible = inputs.possible[i, cells[m, i, 0] * rows + cells[m, i, 1]]
            worst = values[m, i].max()
            for a in range(DIRECTION_COUNT):
                if possible[a]:
                    worst = min(worst, values[m, i, a])
            for a in range(DIRECTION_COUNT):
                if not possible[a]:
                    values[m, i, a] = worst - np.float32(1.0)
    return values


class NetworkConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings that a network was trained with, kept in its file.

    Attributes:
        any_target: whether targets were drawn in training, so that it finds others than those of
            `scenario`, too.
    """

    scenario: Scenario
    process: ProcessConfig
    algorithm: NetworkAlgorithm
    steps: int
    seed: Seed
    network: int = SCHEMA_VERSION
    any_target: bool = False


@dataclass(frozen=True, repr=False)
class NetworkPolicy(GreedyPolicy):
    """Greedy policy of one network that all robots share.

    Attributes:
        config: what it was trained with.
        network: its arrays.
        episodes: episodes trained.
    """

    config: NetworkConfig
    network: Network
    episodes: int

    def __repr__(self) -> str:
        return f"NetworkPolicy(scenario {self.config.scenario.name}, {self.config.algorithm})"

    @cached_property
    def inputs(self) -> Inputs:
        """Return how its inputs are numbered."""
        return Inputs.of(self.config.scenario, self.process)

    def in_scenario(self, scenario: Scenario, name: str = "the policy") -> "NetworkPolicy":
        """Return it in a scenario, which has other starts and targets only if it finds any.

        Args:
            scenario: like that of training.
            name: of the policy, in the error.

        Raises:
            PolicyError: the scenario differs in anything else.
        """
        own = self.config.scenario
        like = replace(own, targets=scenario.targets, starts=scenario.starts)
        if self.config.any_target and like.digest() == scenario.digest():
            return replace(self, config=msgspec.structs.replace(self.config, scenario=scenario))
        self.require_scenario(scenario, name)
        return self

    def _values(self, cells: np.ndarray) -> np.ndarray:
        cells = np.ascontiguousarray(cells)  # the kernel is compiled again for every layout
        return _values(self.inputs, self.network, cells, self.config.scenario.rows)

    def q_values(self, observation: Observation) -> np.ndarray:
        """(N, 8) float32, action values, or logits, of each robot.

        Raises:
            ValueError: a cell is off the board, or the number of robots differs.
        """
        cells = self.seen(observation).cells
        scenario = self.config.scenario
        if ((cells < 0) | (cells >= (scenario.columns, scenario.rows))).any():
            raise ValueError(f"cells {cells.tolist()} are off the board")
        return self._values(cells[None])[0]

    def evaluate(self, starts: np.ndarray | None = None) -> Evaluation:
        """Greedy episodes on the grid, see `agent.mdp.exact.evaluate`.

        Of moves that are worth exactly the same, the first is chosen, not that of the least
        rotation: here robots have no heading. Robots that come back to where they all were circle
        until the step limit: of their rounds one is driven, and the others are counted.
        """
        starts = joint_starts(self.process) if starts is None else starts
        exact = replace(self.config.process, slip_probability=0.0)
        boards = Boards(len(starts), self.config.scenario, exact)
        boards.reset({"starts": starts})
        grid, arrays = boards.grid, boards.arrays
        outcome = np.zeros(len(starts), dtype=np.int8)
        path_cells, steps = np.zeros(starts.shape[:2]), np.zeros(starts.shape[:2], dtype=np.int64)
        actions = np.zeros(starts.shape[:2], dtype=np.int64)
        step, kept, ends = 0, 0, np.full(len(starts), self.config.process.step_limit)
        where, paths = grid.worlds[:, :, _WHERE], path_cells.copy()  # at step `kept`
        counted = path_cells.copy()  # of the rounds that are not driven
        while (going := np.flatnonzero(outcome == RUNNING)).size:
            cells = grid.worlds[going][:, :, [X, Y]]
            actions[going] = self._values(cells).argmax(axis=2)
            steps[going] += arrays.active[going]
            boards.step(actions)
            step += 1
            outcome[going] = arrays.outcomes[going]
            path_cells[going] = grid.path_cells[going]
            now = grid.worlds[:, :, _WHERE]
            circling = (outcome == RUNNING) & (now == where).all(axis=(1, 2))
            rounds = np.where(circling, (ends - step) // (step - kept), 0)[:, None]
            steps += rounds * (step - kept) * arrays.active
            counted += rounds * (path_cells - paths)
            ends -= rounds[:, 0] * (step - kept)
            outcome[(outcome == RUNNING) & (ends == step)] = TIMEOUT
            if step == 2 * kept or step == 1:  # Brent's method finds circles of any length
                where, paths, kept = now, path_cells.copy(), step
        return Evaluation(starts, outcome, path_cells + counted, steps)

    def digest(self) -> str:
        """Hash (16 hex digits) of the readings of the process and of the network."""
        return digest_of(self.config.process, *self.network)

    def maps(self) -> list[PolicyMap]:
        """Return the network's values for each robot in each cell while all others have arrived."""
        scenario = self.config.scenario
        columns, rows = scenario.columns, scenario.rows
        targets = np.array(scenario.targets)
        found = []
        for robot in range(scenario.robots):
            cells = np.repeat(targets[None], columns * rows, axis=0)
            cells[:, robot] = np.stack(np.divmod(np.arange(columns * rows), rows), axis=1)
            values = self._values(cells)[:, robot]
            squared = ((cells - cells[:, [robot]]) ** 2).sum(axis=2)
            squared[:, robot] = self.process.thresholds.contact + 1
            free = (squared > self.process.thresholds.contact).all(axis=1)
            layers = (values.max(axis=1), values.argmax(axis=1), free.astype(float))
            found.append(PolicyMap(*(layer.reshape(columns, rows) for layer in layers)))
        return found

    def arrays(self) -> dict[str, np.ndarray]:
        """Weights and biases."""
        return self.network._asdict()

    @classmethod
    def load(cls, path: Path | str) -> "NetworkPolicy":
        """Read a policy.

        Raises:
            PolicyError: no such file, not a network, or another schema.
        """
        path = Path(path)
        arrays = read_arrays(path, _FILE, (*Network._fields, "config"))
        with parsing(path, _FILE):
            description = dict(json.loads(arrays.pop("config").tobytes()))
            digest, episodes = description.pop("scenario_digest"), description.pop("episodes")
            config = msgspec.convert(description, NetworkConfig)
            policy = cls(config, Network(**arrays), msgspec.convert(episodes, int))
            whole = digest == config.scenario.digest() and policy.network.fits(policy.inputs)
        if not whole or config.network != SCHEMA_VERSION:
            raise PolicyError(f"{path}: network and configuration do not fit; {_MEND}")
        return policy

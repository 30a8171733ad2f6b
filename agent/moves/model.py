"""Effect of a move in the dynamics: moves observed in co-simulation, and their distribution.

P(Δcell, duration | direction, heading, previous direction) is kept as the moves themselves, so that
training draws whole moves (how long the turn took, when and where the robot stopped) instead of
means. Moves of many worlds are kept by world, and a robot draws its world once per episode: robots
that draw another for every move never fall into step, and never learn not to wait for each other
permanently. Observing moves is `agent.moves`, moving robots by them `agent.moves.kernels`.
"""

import math
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
import numpy as np

from cosim.base.errors import UserError
from cosim.base.jit import inlined
from cosim.base.reading import Kind, parsing, read_json
from cosim.base.storage import write_whole
from cosim.model.config import CoSimConfig
from cosim.model.params import TIMING, Facings
from cosim.model.scenario import Scenario
from cosim.onboard.features import DIRECTION_COUNT, facing_of

SCHEMA_VERSION = 1
NO_DIRECTION = -1  # before the first move


class Move(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One move of a robot towards the centre of a neighbouring cell; directions are indices."""

    direction: Annotated[int, msgspec.Meta(ge=0, lt=DIRECTION_COUNT)]
    heading: Annotated[int, msgspec.Meta(ge=0, lt=DIRECTION_COUNT)]  # when it was asked
    previous: Annotated[int, msgspec.Meta(ge=NO_DIRECTION, lt=DIRECTION_COUNT)]  # the move before
    columns: int  # Δcell, of the cell that its centre is in
    rows: int
    turn_s: Annotated[float, msgspec.Meta(ge=0.0)]  # until it first drove
    duration_s: Annotated[float, msgspec.Meta(gt=0.0)]  # until it stopped or was asked again
    drift_x: float  # path of its centre during the turn, in cells
    drift_y: float
    stop_x: float  # where it stopped, from the centre of the cell aimed at, in cells
    stop_y: float


class ObservedMoves(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Observed moves in their order, and what they were observed with."""

    source: str  # digest of the co-simulation's parameters and motor FMU
    seed: int  # of the directions and the speed noise
    moves: tuple[Move, ...]
    # Number of moves of each walk, where every walk had a world of its own (`agent.moves.worlds`);
    # empty where all had the same
    walks: tuple[int, ...] = ()
    rl_step_s: float = TIMING.rl_step_s
    through: bool = False  # whether robots drove on at the end of a move until they were asked
    cell_m: float = Scenario.cell_m  # edge of a cell, the unit of lengths
    facings: Facings = 4  # of the machine, see `SteeringParams.facings`
    # Name of the machine with its motor FMU, and its `CoSimConfig.machine_digest`; empty if unknown
    machine: str = ""
    machine_digest: str = ""

    @property
    def kinds(self) -> int:
        """Number of kinds of moves: straight or diagonal, and the turn before it."""
        return 2 * self.facings

    def kind_of(self, move: Move) -> int:
        """Return the kind of a move."""
        return move_kind(move.direction, move.heading, self.facings)

    def foreign_to(self, config: CoSimConfig) -> bool:
        """Return whether they are known to be of another machine, or other motors."""
        return self.machine_digest not in ("", config.machine_digest)

    def save(self, path: Path) -> None:
        """Write as JSON, whole or not at all."""
        content = {"schema_version": SCHEMA_VERSION} | msgspec.to_builtins(self)
        write_whole(path, msgspec.json.encode(content) + b"\n")

    @classmethod
    def load(cls, path: Path) -> "ObservedMoves":
        """Read what `save` wrote."""
        fix = f"make one with `minirobots moves --out {path}`"
        kind = Kind("file of moves", fix)
        content = read_json(path, kind, dict)
        version = content.pop("schema_version", None)
        with parsing(path, kind):
            moves = msgspec.convert(content, cls)
        if version != SCHEMA_VERSION:
            raise UserError(
                f"{path}: schema {version} is not the schema {SCHEMA_VERSION} of this version; "
                "make it again with `minirobots moves`"
            )
        return moves


class MoveModel(NamedTuple):
    """Observed moves for the kernels, sorted by world and kind.

    The floor is the same in all directions: a move is turned to the first quadrant, so that its
    kind is whether it is diagonal, and the angle between what the robot faces and its direction.
    """

    # (M, 6) float64, time of the turn and of the whole move in s, the path during the turn, and
    # where the robot stopped, from the centre of the cell aimed at, in cells
    moves: np.ndarray
    # (worlds, kinds + 1) int64, moves of kind k in world w are rows offsets[w, k] to [w, k + 1]
    offsets: np.ndarray
    rl_step_s: float
    most_steps: int  # that pass at once where no robot is asked: those of 2 s
    contact_cells: float  # squared distance in cells² at which robots touch
    near_cells: float  # the same beyond which no robots meet within that number of steps


@inlined
def move_kind(direction: int, facing: int, facings: int) -> int:
    """Kind of a move: diagonal or not, and the turn from the direction to what the robot faces.

    `facings` is that of the machine, see `SteeringParams.facings`.
    """
    return direction % 2 * facings + facing_of(facing - direction, facings)


def _turned_back(x: float, y: float, quadrants: int) -> tuple[float, float]:
    for _ in range(quadrants):
        x, y = y, -x
    return x, y


def require_rl_step(rl_step_s: float) -> None:
    """Refuse moves with a longer RL step than the paper's."""
    if not 0.0 < rl_step_s <= TIMING.rl_step_s:
        raise UserError(
            f"moves with an RL step of {rl_step_s:g} s are not usable for learning; observe "
            f"them with an --rl-step of at most {TIMING.rl_step_s:g} s"
        )


def build_model(moves: ObservedMoves, contact_cells: float) -> MoveModel:
    """Return moves by kind, for the kernels; centres at `contact_cells` count as a contact."""
    require_rl_step(moves.rl_step_s)
    fastest = max(
        (
            math.hypot(move.columns, move.rows) / (move.duration_s - move.turn_s)
            for move in moves.moves
            if move.duration_s > move.turn_s
        ),
        default=0.0,
    )
    walks = moves.walks or (len(moves.moves),)
    worlds = np.repeat(np.arange(len(walks)), walks)
    rows: list[list[tuple[float, ...]]] = [[] for _ in range(len(walks) * moves.kinds)]
    for world, move in zip(worlds.tolist(), moves.moves, strict=True):
        quadrants = move.direction // 2
        drift = _turned_back(move.drift_x, move.drift_y, quadrants)
        stop = _turned_back(move.stop_x, move.stop_y, quadrants)
        kind = world * moves.kinds + moves.kind_of(move)
        rows[kind].append((move.turn_s, move.duration_s, *drift, *stop))
    if not all(rows):
        missing = [bool(of_kind) for of_kind in rows].index(False) % moves.kinds
        raise UserError(f"there is no move of kind {missing} of {moves.kinds}; observe more moves")
    most_steps = max(1, round(TIMING.rl_step_s / moves.rl_step_s))
    ends = np.cumsum([0, *(len(of_kind) for of_kind in rows)])
    return MoveModel(
        np.array([row for of_kind in rows for row in of_kind]),
        ends[np.arange(len(walks))[:, None] * moves.kinds + np.arange(moves.kinds + 1)],
        moves.rl_step_s,
        most_steps,
        contact_cells**2,
        (contact_cells + 2.0 * fastest * moves.rl_step_s * most_steps) ** 2,
    )

"""Observes moves in co-simulation: what one drive from a cell to its neighbour really does.

One robot drives about on a large board in the full co-simulation and is asked every RL step, as in
an episode; directions are drawn so that every kind of move is seen equally often. What training
makes of the moves is `agent.moves.model`.
"""

import contextlib
import itertools
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from agent.moves.model import NO_DIRECTION, Move, ObservedMoves, move_kind
from agent.moves.worlds import WorldRange, draw_world
from cosim.base.errors import UserError
from cosim.base.progress import Progress, silent
from cosim.base.storage import cache_dir, cached
from cosim.calibration.measured import key_of
from cosim.coupling.rl_step import Step
from cosim.model.config import CoSimConfig
from cosim.model.scenario import Scenario
from cosim.onboard.features import DIRECTION_COUNT, DIRECTIONS, Observation
from cosim.onboard.steering import DRIVE, HOLD, PAST
from cosim.simulation.batch import Batch

VERSION = 3  # of observed moves: raise it when their bits change

# Walks are simulated side by side; their number decides the bits, the number of threads does not.
# Each has a world of its own where worlds are drawn.
WALKS, WALKS_OF_WORLDS = 16, 64
MOVES_PER_KIND, MOVES_OF_WORLDS_PER_KIND = 24, 256
_PATCHES_CELLS = 14  # patches begin so far from the middle, where walks stay
_SIDE_CELLS = 400
_MARGIN_CELLS = 30  # a walk stays this far from the edge: no edge is in a move's distribution


class _Walker:
    """Chooses directions so that all kinds of moves become equally frequent, and books moves."""

    def __init__(
        self, rng: np.random.Generator, target: int, cell_m: float, config: CoSimConfig
    ) -> None:
        self._rng = rng
        self._target = target
        self._cell_m = cell_m
        self._config, self._facings = config, config.steering.facings
        self._seen = np.zeros(2 * self._facings, dtype=int)
        self._previous = NO_DIRECTION
        self._begun: tuple[int, int, np.ndarray] | None = None  # direction, heading, cell
        self._turn_s = math.nan
        self._from = self._turned = np.zeros(2)
        self._elapsed_s = 0.0
        self.moves: list[Move] = []

    @property
    def done(self) -> bool:
        return bool((self._seen >= self._target).all())

    def choose(self, seen: Observation) -> np.ndarray:
        """(1,) direction of a kind seen least so far, away from the edge."""
        cell, heading = seen.cells[0], int(seen.direction[0])
        kinds = np.array([move_kind(d, heading, self._facings) for d in range(DIRECTION_COUNT)])
        after = cell + DIRECTIONS
        inside = ((after >= _MARGIN_CELLS) & (after < _SIDE_CELLS - _MARGIN_CELLS)).all(axis=1)
        known = np.where(inside, self._seen[kinds], np.iinfo(int).max)
        return self._rng.choice(np.flatnonzero(known == known.min()), size=1)

    def follow_step(self, step: Step) -> None:
        """Follow one RL step, and note the move that ends in it."""
        period_s = self._config.timing.control_period_s
        if step.decided[0]:
            if self._begun is not None:
                raise UserError(self._endless())
            heading = int(step.before.direction[0])
            self._begun = int(step.action[0]), heading, step.before.cells[0]
            self._turn_s, self._elapsed_s = math.nan, 0.0
            self._from = self._turned = step.samples.position[0, 0, :2]
        mode = step.samples.mode[:, 0]
        driving = np.flatnonzero(mode == DRIVE)
        if math.isnan(self._turn_s) and len(driving):
            self._turn_s = self._elapsed_s + period_s * float(driving[0])
            self._turned = step.samples.position[driving[0], 0, :2]
        if step.completed[0] and self._begun is not None:
            ended = np.flatnonzero((mode == HOLD) | (mode == PAST))
            stopped_s = self._elapsed_s + period_s * float(ended[0])
            direction, _, cell = self._begun
            goal = cell + DIRECTIONS[direction] + 0.5
            stop = step.samples.position[-1, 0, :2] / self._cell_m - goal
            self._end(step.after.cells[0], stopped_s, stop)
        self._elapsed_s += period_s * len(mode)

    def _end(self, cell: np.ndarray, duration_s: float, stop: np.ndarray) -> None:
        assert self._begun is not None
        direction, heading, before = self._begun
        turn_s = duration_s if math.isnan(self._turn_s) else self._turn_s
        drift = (self._turned - self._from) / self._cell_m
        columns, rows = (cell - before).tolist()
        measured = turn_s, duration_s, *drift.tolist(), *stop.tolist()
        rounded = (round(value, 6) for value in measured)
        self.moves.append(Move(direction, heading, self._previous, columns, rows, *rounded))
        self._seen[move_kind(direction, heading, self._facings)] += 1
        self._previous = direction
        self._begun = None

    def _endless(self) -> str:
        """Return the message on a move that was given up."""
        config, drove = self._config, not math.isnan(self._turn_s)
        limit_s, steering = config.move_limit_s(self._cell_m), config.steering
        return (
            f"a move of machine {config.preset} does not end: with mu = {config.robot.mu:g} on "
            f"cells of {1e3 * self._cell_m:g} mm it "
            f"{'drove' if drove else 'turned'} for {limit_s:.3g} s, several times what it needs at "
            f"{1e3 * steering.drive_speed_m_s:.3g} mm/s and "
            f"{math.degrees(steering.turn_rate_rad_s):.3g} °/s; change the floor, the motors or "
            "the machine, or make cells smaller"
        )


def source_digest(config: CoSimConfig, fmu: Path, worlds: WorldRange | None = None) -> str:
    """Hash (16 hex digits) of the parameters, motor FMU and worlds that moves depend on."""
    return key_of("moves", VERSION, config, fmu, worlds)


def observe_moves(
    config: CoSimConfig,
    fmu: Path,
    *,
    moves_per_kind: int = MOVES_PER_KIND,
    seed: int = 0,
    worlds: WorldRange | None = None,
    cell_m: float = Scenario.cell_m,
    jobs: int = 2,
    progress: Progress = silent,
) -> ObservedMoves:
    """Observe moves in co-simulation.

    Args:
        moves_per_kind: least number of moves of each kind, see `ObservedMoves.kinds`.
        seed: of directions, speed noise and worlds.
        worlds: from which every walk draws its own; by default all have the configuration's.
        jobs: threads; the result does not depend on it.
    """
    middle = _SIDE_CELLS // 2
    scenario = Scenario(
        name="moves",
        title="one robot on a large board",
        targets=((0, 0),),
        starts=(((middle, middle),),),
        columns=_SIDE_CELLS,
        rows=_SIDE_CELLS,
        cell_m=cell_m,
        robot_diameter_m=config.robot.diameter_m,
    )
    kinds = 2 * config.steering.facings
    walks = WALKS if worlds is None else WALKS_OF_WORLDS
    target = math.ceil(moves_per_kind / walks)
    done = [0] * walks
    endless = config.timing._replace(episode_limit_s=1e9)
    driving = replace(config, timing=endless, shield=None)

    def walk(numbers: range) -> list[list[Move]]:
        walkers: list[_Walker] = []
        with contextlib.closing(Batch(fmu, driving, 1, len(numbers))) as batch:
            for place, number in enumerate(numbers):
                key = np.random.SeedSequence(seed, spawn_key=(number,))
                directions, noise, world = key.spawn(3)
                rng = np.random.default_rng(directions)
                own = driving
                if worlds is not None:
                    of_world = np.random.default_rng(world)
                    drawn = draw_world(worlds, _SIDE_CELLS, _PATCHES_CELLS, of_world)
                    own = driving.in_world(drawn)
                walkers.append(_Walker(rng, target, cell_m, own))
                batch.begin(place, scenario, ((middle, middle),), noise, own)
            while going_on := batch.going_on():
                steps = batch.advance(
                    {place: walkers[place].choose(e.observation) for place, e in going_on.items()}
                )
                for place, step in steps.items():
                    if step.outcome == "out_of_board":
                        raise UserError("the robot strays from its line; check the parameters")
                    walkers[place].follow_step(step)
                    done[numbers[place]] = len(walkers[place].moves)
                    if walkers[place].done:
                        batch.stop(place)
                total = kinds * target * walks
                progress("observing moves", min(sum(done), total), total)
        return [walker.moves for walker in walkers]

    size = max(1, min(WALKS, math.ceil(walks / jobs)))
    parts = [range(first, min(first + size, walks)) for first in range(0, walks, size)]
    with ThreadPoolExecutor(jobs) as threads:
        walked = list(itertools.chain(*threads.map(walk, parts)))
    return ObservedMoves(
        source_digest(config, fmu, worlds),
        seed,
        tuple(itertools.chain(*walked)),
        () if worlds is None else tuple(len(moves) for moves in walked),
        config.timing.rl_step_s,
        config.through,
        cell_m,
        config.steering.facings,
        f"{config.preset} ({fmu.name})",
        config.machine_digest,
    )


def cached_moves(
    config: CoSimConfig,
    fmu: Path,
    progress: Progress = silent,
    worlds: WorldRange | None = None,
    cell_m: float = Scenario.cell_m,
) -> ObservedMoves:
    """The moves of these arguments: found in the cache, or observed and kept."""
    cell = "" if cell_m == Scenario.cell_m else f"-{cell_m}"
    return cached(
        cache_dir("moves") / f"{source_digest(config, fmu, worlds)}{cell}.json",
        ObservedMoves.load,
        lambda: observe_moves(
            config,
            fmu,
            moves_per_kind=MOVES_PER_KIND if worlds is None else MOVES_OF_WORLDS_PER_KIND,
            worlds=worlds,
            cell_m=cell_m,
            progress=progress,
        ),
        ObservedMoves.save,
    )


def facts_of(moves: ObservedMoves) -> dict[str, Any]:
    """Return the number of moves, their mean duration, and how many did not end in their cell."""
    durations = [m.duration_s for m in moves.moves]
    ended = [(m.columns, m.rows) == tuple(DIRECTIONS[m.direction]) for m in moves.moves]
    return {
        "moves": len(durations),
        "mean_duration_s": float(np.mean(durations)),
        "unfinished": ended.count(False),
    }


def move_rows(moves: ObservedMoves) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and rows of a table of the kinds of moves."""
    rows, cell_mm = [], 1e3 * moves.cell_m
    facings = moves.facings
    for kind in range(moves.kinds):
        seen = [m for m in moves.moves if moves.kind_of(m) == kind]
        turn = 45 * ((-kind % facings + facings // 2 - 1) % facings - facings // 2 + 1)
        durations = np.array([m.duration_s for m in seen])
        drift = np.array([math.hypot(m.drift_x, m.drift_y) for m in seen]) * cell_mm
        off = np.array([math.hypot(m.stop_x, m.stop_y) for m in seen]) * cell_mm
        rows.append(
            (
                f"{'diagonal' if kind >= facings else 'straight'} after {turn:+d} deg",
                str(len(seen)),
                f"{np.mean([m.turn_s for m in seen]):.2f}",
                f"{durations.mean():.2f} ± {durations.std():.2f}",
                f"{np.ceil(durations / moves.rl_step_s).mean():.2f}",
                f"{drift.mean():.2f} (at most {drift.max():.2f})",
                f"{off.mean():.2f} (at most {off.max():.2f})",
            )
        )
    header = ("kind", "moves", "turn s", "whole move s", "RL steps", "drift mm", "stop off by mm")
    return header, rows

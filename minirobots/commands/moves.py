"""Observe what moves really do."""

from collections.abc import Iterator
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any

import tyro

from agent.moves.worlds import RANGES, WorldRange
from cosim.base.arguments import ConfigError
from cosim.base.progress import Progress
from cosim.model.scenario import Scenario
from cosim.simulation.options import DecisionOptions, Physics
from minirobots.options import Count, File, IsolatedOptions, Jobs, Positive, Seed, ending


class ObserveMoves(IsolatedOptions):
    """Observe moves of one robot in the co-simulation and keep what they did.

    The file lists every move (direction, heading, previous direction; Δcell, duration, where it
    stopped); `minirobots train --moves FILE` trains with them. With --worlds the policy learns for
    worlds that are not ideal.
    """

    out: Annotated[File, ending(".json")] = Path("runs/moves.json")
    """File to write (.json)."""
    moves: Count = 24
    """Moves of each of the 8 kinds (straight or diagonal, after a turn of 0, 45, 90 or -45 deg)."""
    worlds: bool = False
    """Let every walk drive in a world of its own, drawn from the ranges below."""
    ranges: Annotated[WorldRange, tyro.conf.arg(name="worlds")] = RANGES
    """Ranges that worlds are drawn from uniformly, see docs/methods.md."""
    cell: Annotated[Positive, tyro.conf.arg(metavar="M")] = Scenario.cell_m
    """Edge of a cell in m, that of the scenario to train in."""
    seed: Seed = 0
    jobs: Jobs = -1
    physics: Annotated[Physics, tyro.conf.OmitArgPrefixes] = field(default_factory=Physics)
    deciding: Annotated[DecisionOptions, tyro.conf.OmitArgPrefixes] = field(
        default_factory=DecisionOptions
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.worlds and self.physics.mu is not None:
            raise ConfigError("--mu has no effect with --worlds, which draws it; leave one out")
        if not self.worlds and self.ranges != RANGES:
            raise ConfigError("ranges have no effect without --worlds; add it")


def run(options: ObserveMoves, progress: Progress) -> Iterator[Any]:
    """Observe moves, write their file and print a table of the kinds of moves."""
    from agent.moves.model import require_rl_step
    from agent.moves.observe import facts_of, move_rows, observe_moves
    from agent.moves.worlds import checked_ranges
    from cosim.base.command import workers
    from cosim.base.table import show_texts

    config, fmu = options.physics.prepare(progress=progress)
    config = options.deciding.deciding(config)
    require_rl_step(config.timing.rl_step_s)
    moves = observe_moves(
        config,
        fmu,
        moves_per_kind=options.moves,
        seed=options.seed,
        worlds=checked_ranges(options.ranges, config) if options.worlds else None,
        cell_m=options.cell,
        jobs=workers(options.jobs),
        progress=progress,
    )
    moves.save(options.out)
    yield facts_of(moves) | {"out": str(options.out)}
    show_texts(*move_rows(moves))
    print(f"moves in {options.out}")

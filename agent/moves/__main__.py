"""`python -m agent.moves`: observe moves in co-simulation and write what they did to a file."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from cosim.base.command import Jobs, Json, parse, print_json, require_at_least, workers
from cosim.base.config import ConfigError
from cosim.base.errors import run_command
from cosim.fmi.isolation import Isolation
from cosim.navigation.options import Deciding, Physics


@dataclass(frozen=True, kw_only=True)
class ObserveMoves:
    """Observe moves of one robot in the co-simulation and keep what they did.

    The file lists every move (direction, heading, previous direction; Δcell, duration, where it
    stopped); `python -m agent.train --moves FILE` trains with them.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("runs/moves.json")
    """File to write (.json)."""
    moves: int = 24
    """Moves of each of the 8 kinds (straight or diagonal, after a turn of 0, 45, 90 or -45 deg)."""
    worlds: bool = False
    """Let every walk drive in a world of its own, as for the method robust
    (agent/moves/worlds.py)."""
    seed: int = 0
    """Seed of the directions, the speed noise and the worlds."""
    jobs: Jobs = -1
    json: Json = False
    physics: Annotated[Physics, tyro.conf.OmitArgPrefixes] = field(default_factory=Physics)
    deciding: Annotated[Deciding, tyro.conf.OmitArgPrefixes] = field(default_factory=Deciding)
    isolation: Annotated[Isolation, tyro.conf.OmitArgPrefixes] = field(default_factory=Isolation)

    def __post_init__(self) -> None:
        workers(self.jobs)
        require_at_least(1, moves=self.moves)
        require_at_least(0, seed=self.seed)
        if self.worlds and self.physics.mu is not None:
            raise ConfigError("--mu has no effect with --worlds, which draws it; leave one out")


def main() -> None:
    """Command line; see `ObserveMoves`."""
    options = parse(ObserveMoves, "agent.moves")
    options.isolation.enter("agent.moves", options.physics.motor_fmu)
    from agent.moves.model import require_rl_step
    from agent.moves.observe import facts_of, move_rows, observe_moves
    from agent.moves.worlds import RANGES
    from cosim.base.command import show_table
    from cosim.base.progress import progress_bars

    with progress_bars() as progress:
        config, fmu = options.physics.prepare(progress=progress)
        config = options.deciding.deciding(config)
        require_rl_step(config.timing.rl_step_s)
        moves = observe_moves(
            config,
            fmu,
            moves_per_kind=options.moves,
            seed=options.seed,
            worlds=RANGES if options.worlds else None,
            jobs=workers(options.jobs),
            progress=progress,
        )
    moves.save(options.out)
    show_table(None, *move_rows(moves))
    print(f"moves in {options.out}")
    if options.json:
        print_json(facts_of(moves) | {"out": str(options.out)})


if __name__ == "__main__":
    run_command(main)

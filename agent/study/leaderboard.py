"""A leaderboard: policies of the zoo, one that drives straight, and a user's, in each scenario."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from agent.study.episodes import SCENARIO, rate_column
from agent.study.policies import name_of
from agent.study.user import study
from agent.zoo import Entry, made_with, zoo
from cosim.base.arguments import ConfigError
from cosim.base.jobs import Workers
from cosim.base.progress import Progress, silent
from cosim.base.table import field, markdown, write_report

COLUMNS = (
    SCENARIO,
    field("policy"),
    field("episodes"),
    rate_column("success"),
    field("sim_time_s", "{:.1f} s", "time"),
    field("path_length_cm", "{:.1f} cm", "path"),
)


class Straight:
    """A policy that learns nothing: every robot drives towards its target."""

    def act(self, observation: Any) -> np.ndarray:
        """Return the direction, of eight, that is nearest to that of each robot's target."""
        dx, dy = (observation.targets - observation.cells).T
        return np.rint(np.arctan2(dy, dx) / (np.pi / 4.0)).astype(int) % 8


def leaderboard(
    scenarios: Iterable[str],
    others: Iterable[Any] = (),
    *,
    episodes: int = 50,
    seed: int = 0,
    out: Path,
    where: Workers = Workers(),  # noqa: B008 - a constant
    progress: Progress = silent,
) -> list[Entry]:
    """Measure missing rows, write leaderboard.json and .md, and return the entries.

    In each scenario the policy that succeeds most comes first, of equal ones the fastest. Episodes
    are with `--through`.

    Args:
        scenarios: names of built-in scenarios.
        others: policies to measure as well, as `study` takes them.
        episodes, seed, out, where, progress: options of the command.

    Raises:
        ConfigError: no policy of the zoo is of that scenario.
    """
    entries: list[Entry] = []
    known, added = zoo(), {name_of(policy): policy for policy in others}
    for scenario in scenarios:
        own = {name: name for name, (board, _) in known.items() if board.name == scenario}
        if not own:
            names = ", ".join(dict.fromkeys(board.name for board, _ in known.values()))
            raise ConfigError(f"scenario {scenario} has no leaderboard; choose one of {names}")
        table = study(
            {"straight": Straight(), **own, **added},
            scenario,
            episodes=episodes,
            seed=seed,
            through=True,
            out=out / scenario,
            progress=progress,
            **vars(where),
        )
        found = []
        for row in table.rows:
            record = row.record() | {"made": made_with(row.policy) if row.policy in own else None}
            found.append(msgspec.convert({n: record[n] for n in Entry.__struct_fields__}, Entry))
        entries += sorted(found, key=lambda e: (-(e.success or 0.0), e.sim_time_s or 0.0))
    write_report(out / "leaderboard", entries, markdown(COLUMNS, entries))
    return entries

"""Trained policies of the built-in scenarios, and what they achieve."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import tyro

from cosim.base.arguments import ConfigError
from cosim.base.progress import Progress
from minirobots.options import Count, Distributed, Folder, Resumable, Seed


class Policies(Distributed, Resumable):
    """List the policies of the zoo, or measure a leaderboard of them, with yours in it.

    Any command and `minirobots.load` take their names, such as zoo:4-pair, in place of a file. A
    policy is trained or computed where it is first used, in seconds to minutes, and kept in the
    cache. Measured are episodes with --through, without the shield; results are kept, so that the
    same command with one policy more simulates only that one.
    """

    policies: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    """Your policies to measure next to those of the zoo: files, or MODULE:NAME of an object with
    act(observation) or of its class."""
    scenario: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """Built-in scenario to list or measure; repeat it for several. By default all are listed, and
    1a, 1b, 2, 3 and 4 are measured."""
    measure: bool = False
    """Measure the leaderboard; naming policies of yours does so as well."""
    episodes: Count = 50
    """Episodes of each policy, at most the number of starts."""
    out: Folder = Path("runs/policies")
    """Folder of the leaderboard (leaderboard.json and .md) and all episodes."""
    seed: Seed = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        usual = [self.episodes, self.out, self.seed] == [50, Path("runs/policies"), 0]
        if not (self.measure or self.policies or usual):
            raise ConfigError(
                "--episodes, --out and --seed have no effect on a list; add --measure or a policy"
            )


def run(options: Policies, progress: Progress) -> Iterator[Any]:
    """Print the rows of the zoo or, measured, those of the leaderboard."""
    import msgspec

    from agent.study.leaderboard import leaderboard
    from agent.zoo import zoo_rows
    from cosim.base.table import show_texts
    from cosim.model.built_in import PAPER

    measured = options.measure or options.policies
    if measured:
        arguments = options.arguments("scenario", "policies", "measure", progress=progress)
        entries = leaderboard(options.scenario or tuple(PAPER), options.policies, **arguments)
        rows = [{"current": True} | msgspec.structs.asdict(entry) for entry in entries]
    else:
        rows = zoo_rows(options.scenario)
    yield {"policies": rows}
    cells = []
    for row in rows:
        share, time, path = (row.get(n) for n in ("success", "sim_time_s", "path_length_cm"))
        cells.append(
            (
                row["policy"],
                "not measured" if share is None else f"{share:.1%} of {row['episodes']}",
                "–" if time is None else f"{time:.1f} s",
                "–" if path is None else f"{path:.1f} cm",
                "" if row["current"] or share is None else "by an earlier version",
            )
        )
    show_texts(("policy", "success", "time", "path", "measured"), cells)
    if measured:
        print(f"leaderboard in {options.out}/: leaderboard.json and .md")

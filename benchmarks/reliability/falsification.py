"""Count the episodes until searches find the first collision of a rarely colliding policy."""

from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

from agent.falsification.falsify import FalsificationReport, falsify
from agent.falsification.ranges import read_ranges
from agent.falsification.search import SEARCHES
from agent.method import method_policy
from cosim.base.command import show_table
from cosim.base.progress import progress_bars
from cosim.base.storage import write_json
from cosim.model.scenario_file import find_scenario


@dataclass(frozen=True)
class Searched:
    """A search with a seed.

    Attributes:
        search, seed: of the search.
        episodes: simulated, all of the generation in which the first collision was found.
        first: episodes up to it, None if none was found.
        least_gap_cm: of all episodes.
    """

    search: str
    seed: int
    episodes: int
    first: int | None
    least_gap_cm: float | None


def measure(
    scenario: str,
    method: str,
    shield: bool,
    ranges: Path | None,
    seeds: int,
    episodes: int,
    jobs: int,
    out: Path,
) -> dict[str, Any]:
    """Searches until the first collision; episodes that are in `out` are not simulated again."""
    rows, declared = [], {} if ranges is None else read_ranges(ranges)
    guard = "shield" if shield else "free"
    setting = f"{scenario}-{method}-{guard}-{ranges.stem if ranges else 'default'}"
    with progress_bars() as progress:
        *_, policy = method_policy(method, find_scenario(scenario), progress=progress)
        for seed in range(seeds):
            for search in SEARCHES:
                report = falsify(
                    policy,
                    out=out / f"{setting}-{search}-{seed}",
                    shield=shield,
                    ranges=declared,
                    search=search,
                    episodes=episodes,
                    seed=seed,
                    until_found=True,
                    keep=1,
                    jobs=jobs,
                    progress=progress,
                )
                rows.append(_row(report))
    found = {"scenario": scenario, "method": method, "shield": shield}
    found |= {"ranges": declared, "budget": episodes, "rows": [asdict(row) for row in rows]}
    write_json(out / "falsification.json", found)
    return found


def _row(report: FalsificationReport) -> Searched:
    least = report.worst[0].gap_cm
    return Searched(report.search, report.seed, report.episodes, report.first, least)


def show(found: dict[str, Any]) -> None:
    """Print a row per search and seed, and the medians."""
    budget, rows = found["budget"], found["rows"]
    cells = [
        [
            row["search"],
            str(row["seed"]),
            str(row["first"] or f"more than {row['episodes']}"),
            f"{row['least_gap_cm']:.3f} cm",
        ]
        for row in rows
    ]
    shield = "on" if found["shield"] else "off"
    title = f"scenario {found['scenario']}, method {found['method']}, shield {shield}"
    header = ("search", "seed", "episodes to the first collision", "least gap")
    show_table(None, header, cells, names=2, title=title)
    for search in SEARCHES:
        first = [row["first"] or budget + 1 for row in rows if row["search"] == search]
        middle = median(first)
        shown = f"more than {budget}" if middle > budget else f"{middle:g}"
        print(f"{search}: median {shown}")

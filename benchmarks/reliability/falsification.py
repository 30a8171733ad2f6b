"""Count the episodes until searches find the first collision of a rarely colliding policy.

By a surrogate, by evolution and at random, in the same ranges and with the same seeds. Episodes are
kept in --out: the same command resumes.
"""

from itertools import product
from pathlib import Path
from statistics import median
from typing import Any

from agent.falsification.falsify import falsify
from agent.falsification.ranges import read_ranges
from agent.falsification.search import SEARCHES
from agent.method import method_policy
from cosim.base.progress import progress_bars
from cosim.base.storage import write_json
from cosim.model.scenario_file import find_scenario
from minirobots.options import CommandOptions, Count, File, Folder, Jobs


class Options(CommandOptions):
    scenario: str = "4"
    """Scenario of two robots or more."""
    method: str = "shortest"
    """By which the policy is made, see `python -m cosim.run --help`; one that collides rarely."""
    shield: bool = False
    """Whether robots have the shield (docs/shield.md)."""
    ranges: File | None = None
    """Ranges to search, as of `minirobots falsify`."""
    seeds: Count = 3
    """Searches of each kind."""
    episodes: Count = 200
    """Episodes of a search that finds nothing."""
    jobs: Jobs = -1
    out: Folder = Path("runs/falsification")
    """Folder of results and recordings."""


def measure(options: Options) -> dict[str, Any]:
    rows, method, shield = [], options.method, options.shield
    scenario, episodes, ranges = options.scenario, options.episodes, options.ranges
    declared = {} if ranges is None else read_ranges(ranges)
    guard = "shield" if shield else "free"
    setting = f"{scenario}-{method}-{guard}-{ranges.stem if ranges else 'default'}"
    with progress_bars() as progress:
        *_, policy = method_policy(method, find_scenario(scenario), progress=progress)
        for seed, search in product(range(options.seeds), SEARCHES):
            report = falsify(
                policy,
                out=options.out / f"{setting}-{search}-{seed}",
                shield=shield,
                ranges=declared,
                search=search,
                episodes=episodes,
                seed=seed,
                until_found=True,
                keep=1,
                jobs=options.jobs,
                progress=progress,
            )
            row = {name: getattr(report, name) for name in ("search", "seed", "episodes", "first")}
            rows.append(row | {"least_gap_cm": report.worst[0].gap_cm})
    found = {"scenario": scenario, "method": method, "shield": shield}
    found |= {"ranges": declared, "budget": episodes, "rows": rows}
    found["median_first"] = {  # one more than the budget where none was found
        search: median(row["first"] or episodes + 1 for row in rows if row["search"] == search)
        for search in SEARCHES
    }
    write_json(options.out / "falsification.json", found)
    return found

"""Write what a study found into docs/results: `uv run python .ci/studies.py runs/NAME`.

NAME.json has the numbers of the pages (`.ci/pages.py`), by policy and scenario (with the shield
SCENARIO_shield), all of them for the last scenario of the study, which is the hardest, and over all
worlds together. NAME.csv has a row for every training: what each of its episodes ended in, in the
order of the sample (s is success, c a collision, o out of the board, t the end of the time).
"""

import csv
import json
import sys
from fnmatch import fnmatch
from pathlib import Path

import numpy as np
import pandas as pd

from agent.evaluation.statistics import interval_text, paired_difference, rate_over_trainings

# Differences between policies of a study, by their names: patterns of the first and of the second.
DIFFERENCES = {
    "methods": {"moves_minus_paper": ("moves", "paper")},
    "groups": {"moves_minus_paper": ("moves", "paper")},
    "worlds": {"moves_minus_paper": ("moves", "paper")},
    "ablation": {
        "moves_minus_grid": ("moves-*", "grid-*"),
        "b_minus_g": ("*-b-*", "*-g-*"),
        "large_minus_paper": ("*-large", "*-paper"),
    },
}
RESULTS = Path(__file__).parents[1] / "docs" / "results"


def percent(row: dict, name: str) -> str:
    """Return a rate with its interval, as pages show it."""
    mean, low, high = (100.0 * row[name + end] for end in ("", "_low", "_high"))
    return f"{mean:.1f} [{low:.1f}, {high:.1f}]"


def numbers(row: dict) -> dict[str, str]:
    """Return the numbers of a row of a study that pages show."""
    shares = [round(100.0 * row[f"success_{end}"]) for end in ("least", "most")]
    return {
        "success": percent(row, "success"),
        "range": f"{shares[0]} to {shares[1]}",
        "path_cm": f"{row['path_length_cm']:.1f}",
    }


def successes(episodes: pd.DataFrame, pattern: str) -> np.ndarray:
    """Return which episodes of policies succeeded, (trainings, all combinations and starts)."""
    some = episodes[[fnmatch(policy, pattern) for policy in episodes.policy]]
    trainings = some.groupby(["policy", "training"], sort=False)
    return np.array([of.outcome == "success" for _, of in trainings])


def over_worlds(hits: np.ndarray) -> dict[str, str]:
    """Return the numbers of a policy in all worlds together."""
    shares = np.round(100.0 * hits.mean(axis=1)).astype(int)
    success = interval_text(rate_over_trainings(hits), 1, 100.0)
    return {"success": success, "range": f"{shares.min()} to {shares.max()}"}


def main(folder: Path) -> None:
    """Write both files."""
    name = folder.name
    rows = json.loads((folder / "study.json").read_text("utf-8"))["rows"]
    command = f"uv run minirobots study docs/studies/{name}.toml"
    found: dict = {}
    hardest = rows[-1]["scenario"]
    for row in rows:
        if row.get("shield") and row["min_distance_cm"] is None:
            continue  # a lone robot drives alike with the shield
        own = numbers(row) if row["scenario"] == hardest else {"success": percent(row, "success")}
        shielded = "_shield" * bool(row.get("shield"))
        found.setdefault(row["policy"], {})[f"{row['scenario']}{shielded}"] = own
    episodes = pd.read_parquet(folder / "episodes.parquet")
    axes = [axis for axis in ("world", "shield") if axis in episodes]
    last = episodes[episodes.scenario == hardest]
    last = last[~last.shield] if "shield" in axes else last
    for policy in found if "world" in axes else ():
        found[policy][hardest] = over_worlds(successes(last, policy))
    for key, pair in DIFFERENCES.get(name, {}).items():
        difference = paired_difference(*(successes(last, pattern) for pattern in pair))
        found[key] = interval_text(difference, 1, 100.0)
    text = json.dumps({"command": command, **found}, indent=2, ensure_ascii=False)
    (RESULTS / f"{name}.json").write_text(text + "\n", "utf-8")
    with (RESULTS / f"{name}.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        names = ["policy", "scenario", *axes, "training", "digest"]
        writer.writerow((*names, "outcomes"))
        for keys, of in episodes.groupby(names, sort=False):
            writer.writerow((*keys, "".join(str(outcome)[0] for outcome in of.outcome)))


if __name__ == "__main__":
    main(Path(sys.argv[1]))

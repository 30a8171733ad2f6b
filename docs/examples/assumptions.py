"""Effect of assumed values on the paper's policy in scenario 4, one at a time.

    uv run python docs/examples/assumptions.py --trainings 10 --episodes 5 --out runs/assumptions

Every value has the same trainings, starts and noise. The same command continues after an interrupt.
"""

import argparse
from pathlib import Path

import cosim
import minirobots as mr

OPTIONS = {"mu": [0.15, 0.1, 0.2], "noise": [0.0, 0.1], "reaction": [True]}
MACHINE = {"com_height_m": [0.010, 0.020]}
WORLD = {"restitution": [0.2], "motor_spread": [0.05]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trainings", type=int, default=10)
    parser.add_argument("--episodes", type=int, default=5, help="of each training")
    parser.add_argument("--jobs", type=int, default=-1)
    parser.add_argument("--out", type=Path, default=Path("runs/assumptions"))
    given = parser.parse_args()
    studies = [{name: values} for name, values in OPTIONS.items()]
    worlds = [{name: value} for name, values in WORLD.items() for value in values]
    studies += [{"world": worlds}] if worlds else []
    paper = cosim.find_preset("paper")
    for name, values in MACHINE.items():
        presets = []
        for value in values:
            presets.append(given.out / f"{name}-{value}.toml")
            presets[-1].parent.mkdir(parents=True, exist_ok=True)
            paper._replace(tree={**paper.tree, name: (value, "varied")}).save(presets[-1])
        studies.append({"preset": [str(path) for path in presets]})
    for axis in studies:
        out = given.out / next(iter(axis))
        how = {"trainings": given.trainings, "episodes": given.episodes, "jobs": given.jobs}
        table = mr.study("paper", "4", out=out, **how, **axis)
        print(table.to_markdown())


if __name__ == "__main__":
    main()

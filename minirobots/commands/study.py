"""A study of your own: policies, scenarios, worlds and any options as axes."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import tyro

from cosim.base.arguments import require_one_of, validate_argument
from cosim.base.progress import Progress
from minirobots.options import BudgetMinutes, Distributed, Folder, Resumable


class Study(Distributed, Resumable):
    """Measure policies in every combination of scenarios, worlds and options of a TOML file.

    docs/studies.md describes the file. Every episode is kept when it ends: the same command
    resumes, and with --budget-minutes 0 it starts no episode and writes the tables of existing
    results. Policies and calibrations that are missing are made first.
    """

    file: Annotated[Path, tyro.conf.Positional]
    """Study (.toml)."""
    out: Folder | None = None
    """Folder of the tables (study.json, .md, .parquet, .png, episodes.parquet) and results; by
    default that of the file, or runs/ and its name."""
    quantity: str = "success"
    """Quantity of the plot: success, collision, out_of_board, timeout, path_length_cm,
    rotation_deg, path_ratio_to_grid, min_distance_cm, sim_time_s or energy_j."""
    budget_minutes: BudgetMinutes = None


def run(options: Study, progress: Progress) -> Iterator[Any]:
    """Simulate missing episodes, and write and print the tables."""
    from agent.study.plot import QUANTITIES
    from agent.study.user import read_study, study

    require_one_of("quantity", options.quantity, QUANTITIES)
    arguments = read_study(options.file)
    out = options.out or validate_argument(
        "out", arguments.get("out", Path("runs") / options.file.stem), Path
    )
    work = {"out": out, "budget_minutes": options.budget_minutes, "progress": progress}
    table = study(**{**arguments, **vars(options.where), **work})
    if options.quantity != "success":
        table.write(out / "study.png", options.quantity)
    yield {"out": str(out), "rows": [row.record() for row in table.rows]}
    table.show()
    print(f"tables in {out}/: study.json, .md, .parquet, .png and episodes.parquet")

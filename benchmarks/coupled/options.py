"""Options of the benchmarks of this folder."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from benchmarks.options import Benchmark


@dataclass(frozen=True, kw_only=True)
class ReferenceFmus(Benchmark):
    """Run the reference FMUs of the Modelica Association to the outputs that they publish."""

    src: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Copy of https://github.com/modelica/Reference-FMUs."""


@dataclass(frozen=True, kw_only=True)
class System(Benchmark):
    """Couple two oscillators by each algorithm, and time a step next to a loop through fmpy."""

    rounds: int = 20
    """Rounds of the measurement of time; the best counts."""

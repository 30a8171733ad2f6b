"""Options of the benchmarks of this folder."""

from dataclasses import dataclass

from benchmarks.options import Benchmark, Seconds
from cosim.model.config import whole_ratio
from cosim.model.params import TIMING


@dataclass(frozen=True, kw_only=True)
class Ssp(Benchmark):
    """Hold masters not written here on the SSP archives of two robots against ours.

    Each drives the pair with constant motor set points on an open floor.
    """

    step: Seconds = 1e-4
    """Communication step in s: 1e-3 s is a whole number of them."""
    duration: Seconds = 1.0
    """Simulated time in s."""

    def __post_init__(self) -> None:
        whole_ratio("--step", self.step, "the internal step", TIMING.dt_s)
        whole_ratio("1e-3 s", 1e-3, "--step", self.step)
        whole_ratio("--duration", self.duration, "1e-3 s", 1e-3)

"""Other projects' masters on the pair of robots, compared with ours.

Every master steps the FMUs of one archive from `fmus.ssp` with constant motor set points on an open
floor. What remains between it and ours is its algorithm: whether all FMUs step at once (Jacobi) or
the motors first (Gauss-Seidel), and whether bodies know the motors' first outputs in the first
step. With the same algorithm the bits are ours.
"""

import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from cosim.model.config import Order, whole_ratio
from cosim.model.params import TIMING
from fmus.ssp.archive import build_ssp
from minirobots.options import CommandOptions, Seconds
from tests.references.containers import pack_with_fmpy, pack_with_toolbox, simulate
from tests.references.importers import relabelled, run
from tests.references.own import PERIOD_S, drive

Poses = np.ndarray  # (n, robots, 7) after every millisecond
Case = tuple[str, Order, bool, Callable[[], Poses]]


class Options(CommandOptions):
    step: Seconds = 1e-4
    """Communication step in s: 1e-3 s is a whole number of them."""
    duration: Seconds = 1.0
    """Simulated time in s."""

    def __post_init__(self) -> None:
        super().__post_init__()
        whole_ratio("--step", self.step, "the internal step", TIMING.dt_s)
        whole_ratio("1e-3 s", 1e-3, "--step", self.step)
        whole_ratio("--duration", self.duration, "1e-3 s", 1e-3)


def cases(folder: Path, step_s: float, duration_s: float) -> Iterator[Case]:
    """Name, order, whether outputs are exchanged before the first step, and the run of each master.

    Args:
        folder: for archives and containers.
        step_s: communication step.
        duration_s: simulated time.
    """
    first, second = build_ssp(folder)
    again = relabelled(second, folder / "relabelled.ssp")
    for name, archive in (("fmpy", first), ("ecospy", first), ("libcosimpy", first)):
        yield name, "jacobi", name != "fmpy", partial(run, name, archive, step_s, duration_s)
    yield "ecospy, FMI 3", "jacobi", True, partial(run, "ecospy", again, step_s, duration_s)

    def contained(pack: Callable[..., Path], archive: Path, fmi: str, **options: bool) -> Poses:
        with tempfile.TemporaryDirectory(dir=folder) as place:
            made = pack(archive, fmi, step_s, Path(place), **options)
            return simulate(made, duration_s, PERIOD_S)

    for fmi, archive in (("2", first), ("3", second)):
        for maker, pack in (("fmpy", pack_with_fmpy), ("toolbox", pack_with_toolbox)):
            name = f"container by {maker}, FMI {fmi}"
            yield name, "jacobi", True, partial(contained, pack, archive, fmi)
    sequential = partial(contained, pack_with_toolbox, second, "3", sequential=True)
    yield "sequential container by toolbox, FMI 3", "gauss-seidel", True, sequential


def measure(options: Options) -> dict[str, dict[str, float | bool | str]]:
    step, duration = options.step, options.duration
    usual, found = drive(duration), {}
    with tempfile.TemporaryDirectory() as folder:
        for name, order, exchange_first, poses in cases(Path(folder), step, duration):
            own = drive(duration, order, step, exchange_first=exchange_first)
            other = drive(duration, order, step, exchange_first=not exchange_first)
            theirs = poses()
            found[name] = {
                "order": order,
                "exchange_first": exchange_first,
                "same_bits": theirs.tobytes() == own.tobytes(),
                "from_ours_of_that_order_m": _apart(theirs, own),
                "from_ours_with_other_first_exchange_m": _apart(theirs, other),
                "from_our_usual_m": _apart(theirs, usual),
            }
    return found


def _apart(a: Poses, b: Poses) -> float:
    return float(np.abs(a - b)[..., :3].max())

"""Compilation of the co-simulation in a second process, while this one trains."""

import atexit
import contextlib
import pickle
import subprocess
import sys
from collections.abc import Iterator

from cosim.base.command import workers
from cosim.base.jit import is_compiled
from cosim.coupling.master import run_periods
from cosim.simulation.batch import DRIVERS, Batch
from cosim.simulation.options import SimulationOptions
from cosim.simulation.tasks import places

_CALL = "import pickle, sys; f, arguments = pickle.load(sys.stdin.buffer); f(*arguments)"


@contextlib.contextmanager
def compiling_ahead(
    robots: int, driver: str = DRIVERS[0], episodes: int = 1, threads: int = 1
) -> Iterator[subprocess.Popen | None]:
    """Have a second process compile the co-simulation if it never was, and if a core is free.

    It ends with this process, and when an error leaves the context; otherwise it continues after
    that. Whatever needs the kernels waits for it, or compiles them if it has failed.

    Args:
        robots: of an episode.
        driver: of the co-simulation.
        episodes: how many will be simulated.
        threads: batches at the same time.

    Yields:
        The process, None if there is none.
    """
    if workers(-1) < 2 or is_compiled(run_periods):
        yield None
        return
    child = subprocess.Popen(
        [sys.executable, "-c", _CALL],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C is for this process
    )
    atexit.register(child.kill)
    if child.stdin is not None:
        with contextlib.suppress(BrokenPipeError), child.stdin:
            pickle.dump((_compile, (robots, driver, episodes, threads)), child.stdin)
    try:
        yield child
    except BaseException:
        child.kill()
        raise


def _compile(robots: int, driver: str, episodes: int, threads: int) -> None:
    """Compile the kernels of batches, whose FMUs and parameters make no difference."""
    options = SimulationOptions()
    config, fmu = options.config(), options.fmu()
    Batch(fmu, config, robots, places(driver, robots, episodes, threads), driver).compile()

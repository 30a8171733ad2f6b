"""Compilation of the co-simulation in a second process, while this one trains."""

import atexit
import contextlib
import subprocess
import sys
from collections.abc import Iterator

from cosim.base.command import workers
from cosim.base.jit import is_compiled
from cosim.coupling.master import run_periods
from cosim.simulation.batch import places_for

# Only what is compiled is imported. FMUs and parameters make no difference to kernels; those of
# machines with other motors or feet are compiled when they are calibrated.
_COMPILE = """
from cosim.model.config import CoSimConfig
from cosim.simulation.batch import Batch
from fmus.build import cached_fmu
Batch(cached_fmu(), CoSimConfig(), robots={robots}, places={places}, driver="{driver}").compile()
"""


@contextlib.contextmanager
def compiling_ahead(
    robots: int, driver: str = "fmpy", episodes: int = 1, threads: int = 1
) -> Iterator[subprocess.Popen | None]:
    """Have a second process compile the co-simulation if it never was, and if a core is free.

    It ends with this process, and when an error leaves the context; otherwise it continues after
    that. Whatever needs the kernels waits for it, or compiles them if it has failed.
    """
    if workers(-1) < 2 or is_compiled(run_periods):
        yield None
        return
    places = places_for(driver, robots, episodes, threads)
    child = subprocess.Popen(
        [sys.executable, "-c", _COMPILE.format(robots=robots, places=places, driver=driver)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C is for this process
    )
    atexit.register(child.kill)
    try:
        yield child
    except BaseException:
        child.kill()
        raise

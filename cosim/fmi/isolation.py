"""A command in a process of its own, so that an FMU that crashes ends it with a one-line error.

An FMU is native code: it may crash the process that runs it. This holds faults, not malice: the
child process may do what the user may.
"""

import os
import signal
import subprocess
import sys
from pathlib import Path

from cosim.base.errors import Terminated

_CHILD = "MINIROBOTS_ISOLATED"  # in the environment of a child


def isolate(command: str, fmu: Path | None) -> None:
    """Run this process's command again in a child process; return only in that child.

    Ctrl-C and SIGTERM reach the child once. Ctrl-C again kills it, if an FMU does not return.
    """
    from cosim.fmi.fmu import FmuError  # noqa: PLC0415 - not for every --help

    if _CHILD in os.environ:
        return
    line = [sys.executable, "-m", *command.split(), *sys.argv[1:]]
    interrupted: KeyboardInterrupt | None = None
    # A session of its own: a terminal's Ctrl-C reaches the child through this process alone.
    with subprocess.Popen(line, env=os.environ | {_CHILD: "1"}, start_new_session=True) as child:
        while child.poll() is None:
            try:
                child.wait()
            except KeyboardInterrupt as interrupt:
                ended = signal.SIGTERM if isinstance(interrupt, Terminated) else signal.SIGINT
                child.send_signal(signal.SIGKILL if interrupted else ended)
                interrupted = interrupt
    if child.returncode >= 0:
        sys.exit(child.returncode)
    if interrupted:
        raise interrupted
    raise FmuError(
        f"{f'motor FMU {fmu}' if fmu else 'the built-in motor FMU'} crashed "
        f"({signal.Signals(-child.returncode).name}), and the command with it; "
        "export the FMU again, or use the built-in one"
    )

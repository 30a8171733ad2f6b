"""Runs commands of the project one after the other, with memory and processor time bounded.

Reads `[command, argument, ...]` from a line of stdin, answers with a line of JSON on stdout: how
the command ended, what it said, and the most memory that this process has ever taken. A command
that takes more memory than it may gets a MemoryError; one that takes too long ends this process.
"""

import contextlib
import io
import json
import resource
import sys
from pathlib import Path

from minirobots.__main__ import main

MAX_GROWTH_BYTES = 4 * 2**30  # of addresses, more than is used
MAX_CPU_S = 300  # kernels may have to be compiled


def run(*arguments: str) -> tuple[object, str, str, int]:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MAX_GROWTH_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, resource.RLIM_INFINITY))
    used = resource.getrusage(resource.RUSAGE_SELF)
    most_s = int(used.ru_utime + used.ru_stime) + MAX_CPU_S
    resource.setrlimit(resource.RLIMIT_CPU, (most_s, resource.RLIM_INFINITY))
    out, err, status = io.StringIO(), io.StringIO(), 0
    sys.argv = ["minirobots", *arguments]
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main()
        except SystemExit as end:
            status = end.code or 0
    most_bytes = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return status, out.getvalue(), err.getvalue(), most_bytes


for line in sys.stdin:
    print(json.dumps(run(*json.loads(line))), flush=True)

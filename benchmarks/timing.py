"""Times of calls; those that are compared take turns, so that all meet the same machine."""

import time
from collections.abc import Callable

import numpy as np


def best_s(
    rounds: int, *works: Callable[[], object], clock: Callable[[], float] = time.thread_time
) -> list[float]:
    """Return the shortest time of each call in s, by default of the processor."""
    times = []
    for _ in range(rounds):
        for work in works:
            began = clock()
            work()
            times.append(clock() - began)
    return [min(times[k :: len(works)]) for k in range(len(works))]


def times_s(work: Callable[[], object]) -> np.ndarray:
    """Return the wall-clock and the processor time of a call, in s."""
    began = time.perf_counter(), time.process_time()
    work()
    return np.array([time.perf_counter() - began[0], time.process_time() - began[1]])

"""Sampled signals of consecutive RL steps, joined and reduced to the rows of a recording."""

from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np
import rerun as rr

from cosim.coupling.rl_step import Step
from cosim.coupling.signals import Samples
from cosim.model.params import TimingParams
from cosim.recording.file import simulated


class Stretch:
    """Sampled signals of consecutive RL steps.

    Only the rows that are needed are joined, because joining all of them takes longer.

    Args:
        steps: the steps.
        timing: tick and control period.

    Attributes:
        time_s: (n,) end of every control period.
    """

    def __init__(self, steps: Sequence[Step], timing: TimingParams) -> None:
        ticks = round(timing.control_period_s / timing.dt_s)
        sampled = [step for step in steps if len(step.samples.omega)]
        ends = [s.first_tick + ticks * np.arange(1, len(s.samples.omega) + 1) for s in sampled]
        self.time_s = timing.dt_s * np.concatenate([np.zeros(0), *ends])
        self._samples = [step.samples for step in sampled]
        self._lengths = np.array([len(end) for end in ends], dtype=np.int64)
        self._firsts = self._lengths.cumsum() - self._lengths
        self._times: dict[int, list[rr.TimeColumn]] = {}
        self._last: dict[int, Any] = {}

    def ends(self, every: int) -> np.ndarray:
        """Return the last row of each block of `every` periods; the last block may be shorter."""
        count = len(self.time_s)
        return np.minimum(np.arange(every - 1, count + every - 1, every), count - 1)

    def times(self, every: int) -> list[rr.TimeColumn]:
        """Return the times of the ends of blocks."""
        if every not in self._times:
            self._times[every] = simulated(self.time_s[self.ends(every)])
        return self._times[every]

    def last(self, every: int) -> Any:
        """Return the samples at the ends of blocks."""
        if every not in self._last:
            self._last[every] = self.at(self.ends(every))
        return self._last[every]

    def at(self, rows: np.ndarray) -> Any:
        """Return the samples of some rows, in order."""
        parts = np.split(rows, np.searchsorted(rows, self._firsts[1:]))
        own = [part - first for part, first in zip(parts, self._firsts, strict=True)]
        return _Joined(self._samples, own)

    def bursts(self, periods: int) -> np.ndarray:
        """Return the rows of the first periods of each RL step."""
        steps = zip(self._firsts, self._lengths, strict=True)
        return np.concatenate([first + np.arange(min(periods, n)) for first, n in steps])

    def reduced(
        self, signal: Callable[[Samples], np.ndarray], every: int, how: Literal["mean", "max"]
    ) -> np.ndarray:
        """Return a signal's mean or maximum over blocks.

        Args:
            signal: (n, N, ...) of samples, at every control period.
            every: periods of a block.
            how: what a row says of its block.
        """
        whole = not (self._lengths[:-1] % every).any()
        parts: list[Any] = self._samples if whole else [self.last(1)]
        reduced = [_reduce(signal(part).swapaxes(0, 1), every, how) for part in parts]
        return np.concatenate(reduced, axis=1).swapaxes(0, 1)


class _Joined:
    """Samples one after the other; a signal is joined when it is first asked for."""

    def __init__(self, samples: Sequence[Samples], rows: Sequence[np.ndarray]) -> None:
        self._parts = list(zip(samples, rows, strict=True))

    def __getattr__(self, name: str) -> np.ndarray:
        # A robot's rows lie together, as Arrow wants them.
        parts = [getattr(samples, name).swapaxes(0, 1)[:, rows] for samples, rows in self._parts]
        setattr(self, name, np.concatenate(parts, axis=1).swapaxes(0, 1))
        return getattr(self, name)


def _reduce(values: np.ndarray, every: int, how: Literal["mean", "max"]) -> np.ndarray:
    """Return the mean or maximum over blocks of `every` rows (axis 1), the last possibly shorter.

    Args:
        values: (N, n, ...), n ≥ 1.
        every: rows of a block.
        how: which of the two.
    """
    if every == 1:
        return values
    count = values.shape[1]
    starts = np.arange(0, count, every)
    if how == "max":
        return np.maximum.reduceat(values, starts, axis=1)
    counts = np.diff(np.append(starts, count)).astype(np.float64)
    shape = (-1, *[1] * (values.ndim - 2))
    return np.add.reduceat(values, starts, axis=1) / counts.reshape(shape)

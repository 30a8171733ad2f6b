"""Sampled signals of consecutive RL steps, joined and reduced to the rows of a recording."""

from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np

from cosim.coupling.rl_step import Step
from cosim.model.params import TimingParams


class Stretch:
    """Samples of consecutive RL steps, one after the other.

    Has the fields of `cosim.coupling.signals.Samples`; each is joined when it is first read.

    Args:
        steps: the steps.
        timing: tick and control period.

    Attributes:
        time_s: (n,) end of every control period.
    """

    def __init__(self, steps: Sequence[Step], timing: TimingParams) -> None:
        ticks = round(timing.control_period_s / timing.dt_s)
        self._samples = [step.samples for step in steps if len(step.samples.omega)]
        firsts = [step.first_tick for step in steps if len(step.samples.omega)]
        self._lengths = [len(samples.omega) for samples in self._samples]
        ends = [f + ticks * np.arange(1, n + 1) for f, n in zip(firsts, self._lengths, strict=True)]
        self.time_s = timing.dt_s * np.concatenate([np.zeros(0), *ends])

    def __getattr__(self, name: str) -> np.ndarray:
        joined = np.concatenate([getattr(samples, name) for samples in self._samples])
        setattr(self, name, joined)
        return joined

    def ends(self, every: int) -> np.ndarray:
        """Return the last row of each block of `every` periods; the last block may be shorter."""
        count = len(self.time_s)
        return np.minimum(np.arange(every - 1, count + every - 1, every), count - 1)

    def bursts(self, periods: int) -> np.ndarray:
        """Return the rows of the first periods of each RL step."""
        firsts = np.cumsum([0, *self._lengths[:-1]])
        steps = zip(firsts, self._lengths, strict=True)
        return np.concatenate([first + np.arange(min(periods, n)) for first, n in steps])

    def rows(
        self, signal: Callable[[Any], np.ndarray], every: int, how: Literal["mean", "max", "last"]
    ) -> np.ndarray:
        """Return a signal's mean or maximum over blocks, or its last value in them.

        Args:
            signal: (n, N, ...) of samples.
            every: periods of a block; the last block may be shorter.
            how: what a row says of its block.
        """
        if how == "last":
            return signal(_Rows(self, self.ends(every)))
        values, starts = signal(self), np.arange(0, len(self.time_s), every)
        if every == 1:
            return values
        if how == "max":
            return np.maximum.reduceat(values, starts)
        counts = np.diff(np.append(starts, len(values))).astype(np.float64)
        return np.add.reduceat(values, starts) / counts.reshape(-1, *[1] * (values.ndim - 1))


class _Rows:
    """Some rows of samples."""

    def __init__(self, samples: Stretch, rows: np.ndarray) -> None:
        self._samples, self._rows = samples, rows

    def __getattr__(self, name: str) -> np.ndarray:
        return getattr(self._samples, name)[self._rows]

"""Amount of an episode that is recorded: rates of the levels of `--record`.

A row of a Rerun table costs some 35 bytes for any content, so rates decide what a recording
weighs; docs/performance.md has the sizes. What the signals are is `cosim.recording.series`.
"""

import math
from typing import Literal, NamedTuple

from cosim.coupling.signals import RawSamples
from cosim.model.config import CoSimConfig

Level = Literal["summary", "default", "full"]


class Detail(NamedTuple):
    """Times between the rows of a level, in s; infinite is once per RL step.

    Attributes:
        fast_s: of what changes within a motor turn: speeds and voltages.
        slow_s: of everything else; forces and shares are means over it, impacts the largest.
        pose_s: of poses, positions and headings.
        loop_s: of what the motors' controllers work with; None for nothing.
        burst_s: length of the burst at the start of every RL step that is kept at every tick.
        burst_signals: fields of `cosim.coupling.signals.RawSamples` in the burst.
    """

    fast_s: float
    slow_s: float
    pose_s: float
    loop_s: float | None
    burst_s: float
    burst_signals: tuple[str, ...]


DETAILS: dict[Level, Detail] = {
    "summary": Detail(math.inf, math.inf, 0.1, None, 0.0, ()),
    # 9 ms are 1.4 motor turns; slow rows meet the ends of RL steps, where bursts begin.
    "default": Detail(
        0.001, 0.025, 0.025, None, 0.009, ("omega", "position", "normal", "friction")
    ),
    "full": Detail(0.001, 0.001, 0.001, 0.001, 0.05, RawSamples._fields),
}


def with_bursts(config: CoSimConfig, level: Level | Literal["none"]) -> CoSimConfig:
    """A configuration that samples the bursts of a level, and none where nothing is recorded."""
    burst_s = 0.0 if level == "none" else DETAILS[level].burst_s
    return config.having("a recording's level", burst_s=burst_s)


def periods(time_s: float, control_period_s: float, rl_step_s: float) -> int:
    """Control periods between two rows: at least one, at most an RL step's."""
    return max(1, round(min(time_s, rl_step_s) / control_period_s))

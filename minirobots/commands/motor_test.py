"""Record the test of Fig. 7, a motor in open and closed loop."""

from dataclasses import field
from pathlib import Path
from typing import Annotated

import tyro

from analysis.motor.loop_options import StepTest
from cosim.base.command import MotorFmuFile
from cosim.base.progress import Progress
from minirobots.options import File, IsolatedOptions, ending


class MotorTest(IsolatedOptions):
    """Record the step responses of Fig. 7: one motor in open loop, and one in closed loop.

    From one third of the time on a disturbance torque drives the shaft, from two thirds on it
    brakes it: the open loop settles elsewhere, the closed loop returns to its set point.
    """

    out: Annotated[File, ending(".rrd")] = Path("runs/motor_test.rrd")
    """Recording to write (.rrd)."""
    motor_fmu: MotorFmuFile = None
    test: Annotated[StepTest, tyro.conf.OmitArgPrefixes] = field(default_factory=StepTest)


def run(options: MotorTest, _: Progress) -> dict[str, str]:
    """Record the test."""
    from analysis.motor.step_test import record
    from fmus.build import cached_fmu

    record(options.out, options.motor_fmu or cached_fmu("VibrationMotor"), options.test)
    return {"out": str(options.out)}

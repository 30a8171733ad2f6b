"""`python -m analysis.motor_test`: record the test of Fig. 7, a motor in open and closed loop."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from analysis.motor.options import StepTest
from cosim.base.command import Json, MotorFmuFile, parse, print_json
from cosim.base.errors import run_command
from cosim.fmi.isolation import Isolation


@dataclass(frozen=True)
class MotorTest:
    """Record the step responses of Fig. 7: one motor in open loop, and one in closed loop.

    From one third of the time on a disturbance torque drives the shaft, from two thirds on it
    brakes it: the open loop settles elsewhere, the closed loop returns to its set point.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("runs/motor_test.rrd")
    """Recording to write (.rrd)."""
    motor_fmu: MotorFmuFile = None
    json: Json = False
    test: Annotated[StepTest, tyro.conf.OmitArgPrefixes] = field(default_factory=StepTest)
    isolation: Annotated[Isolation, tyro.conf.OmitArgPrefixes] = field(default_factory=Isolation)


def main() -> None:
    """Command line; see `MotorTest`."""
    options = parse(MotorTest, "analysis.motor_test")
    options.isolation.enter("analysis.motor_test", options.motor_fmu)
    from analysis.motor.step_test import record
    from fmus.build import cached_fmu

    record(options.out, options.motor_fmu or cached_fmu("VibrationMotor"), options.test)
    print(f"recording: {options.out}")
    if options.json:
        print_json({"out": str(options.out)})


if __name__ == "__main__":
    run_command(main)

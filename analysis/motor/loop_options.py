"""Options of the motor's test, declared once: fields of the command and argument of the library."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from cosim.base.command import MotorParameters
from cosim.model.params import FIG_7


@dataclass(frozen=True, kw_only=True)
class StepTest:
    """Test to apply to the motor."""

    duration: Annotated[float, tyro.conf.arg(metavar="S", aliases=["--duration-s"])] = 6.0
    """Simulated time in s."""
    omega_des: Annotated[float, tyro.conf.arg(metavar="RAD_S")] = FIG_7.omega_des
    """Set point of the closed loop in rad/s."""
    open_loop_v: Annotated[float, tyro.conf.arg(metavar="V")] = FIG_7.open_loop_V
    """Voltage of the open loop in V."""
    d: Annotated[float, tyro.conf.arg(metavar="NM")] = FIG_7.d
    """Disturbance torque in N m."""
    motor_parameters: MotorParameters = ()

"""Options of the motor's test, declared once: fields of the command and argument of the library."""

from dataclasses import dataclass
from typing import Annotated

import tyro
from msgspec import Meta

from cosim.base.command import Checked, MotorParameters
from cosim.model.params import FIG_7

Duration = Annotated[float, Meta(gt=0, le=3600)]
Finite = Annotated[float, Meta(ge=-1e12, le=1e12)]


@dataclass(frozen=True, kw_only=True)
class StepTest(Checked):
    """Test to apply to the motor."""

    duration: Annotated[Duration, tyro.conf.arg(metavar="S", aliases=["--duration-s"])] = 6.0
    """Simulated time in s."""
    omega_des: Annotated[Finite, tyro.conf.arg(metavar="RAD_S")] = FIG_7.omega_des
    """Set point of the closed loop in rad/s."""
    open_loop_v: Annotated[Finite, tyro.conf.arg(metavar="V")] = FIG_7.open_loop_V
    """Voltage of the open loop in V."""
    d: Annotated[Finite, tyro.conf.arg(metavar="NM")] = FIG_7.d
    """Disturbance torque in N m."""
    motor_parameters: MotorParameters = ()

"""Options of the physics, declared once: fields of commands and arguments of `cosim.simulate`."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from cosim.base.command import MotorFmuFile
from cosim.base.config import CoSimConfig, OnCollision, Order
from cosim.base.params import SAFETY_MARGIN_HELP, SPEED_NOISE, STEERING, TABLE_I, TIMING
from cosim.base.progress import Progress, silent, under_way


@dataclass(frozen=True, kw_only=True)
class Physics:
    """Robots, motors and clock: what a calibration depends on."""

    mu: float = TABLE_I.mu
    """Coulomb friction coefficient of the feet (0.1 to 0.4 in the literature). Above some 0.2 the
    default drive speed needs hopping and is refused."""
    noise: float = SPEED_NOISE.relative_amplitude
    """Half width of the uniform noise on measured motor speeds, relative to the drive speed."""
    dt: Annotated[float, tyro.conf.arg(metavar="S")] = TIMING.dt_s
    """Integration step of the bodies in s."""
    communication_step: Annotated[float | None, tyro.conf.arg(metavar="S")] = None
    """Time between exchanges with the FMUs in s, a whole multiple of dt; by default dt."""
    order: Order = "gauss-seidel"
    """Whether bodies see the motors' outputs of the end (interpolated) or of the start
    (extrapolated) of a communication step."""
    reaction: bool = False
    """Let the motors feel the acceleration of the body, which the paper neglects."""
    motor_fmu: MotorFmuFile = None

    def config(self) -> CoSimConfig:
        """Parameters of the co-simulation, of robots of 5 cm and not yet calibrated.

        Raises:
            ConfigError: they do not fit together.
        """
        return CoSimConfig(
            robot=TABLE_I._replace(mu=self.mu),
            noise=SPEED_NOISE._replace(relative_amplitude=self.noise),
            timing=TIMING._replace(
                dt_s=self.dt, communication_step_s=self.communication_step or self.dt
            ),
            order=self.order,
            reaction=self.reaction,
        )

    def fmu(self, progress: Progress = silent) -> Path:
        """The motor FMU: the one named, or the built-in one, which is compiled the first time.

        Raises:
            UserError: it cannot be compiled.
        """
        # here, because commands parse their options before they load fmpy
        from fmus.build import cached_fmu  # noqa: PLC0415

        with under_way(progress, "preparing the motor FMU"):
            return self.motor_fmu or cached_fmu()

    def prepare(
        self, diameter_m: float = TABLE_I.diameter_m, progress: Progress = silent
    ) -> tuple[CoSimConfig, Path]:
        """Calibrated parameters for robots of a diameter, and the motor FMU.

        The built-in FMU is compiled the first time, a calibration measured (some seconds each).

        Raises:
            ConfigError: the parameters do not fit together.
            CalibrationError: the drive speed needs hopping.
            FmuError: the FMU cannot be used, or failed.
        """
        config = self.config().sized(diameter_m)
        from cosim.calibration.cache import calibrated  # noqa: PLC0415 - as above

        fmu = self.fmu(progress)
        return calibrated(config, fmu, progress), fmu


@dataclass(frozen=True, kw_only=True)
class Driving(Physics):
    """Robots, motors and clock, and how the robots drive with them."""

    speed: Annotated[float, tyro.conf.arg(metavar="MM_S")] = 1e3 * STEERING.drive_speed_m_s
    """Speed while driving, in mm/s; motor speeds follow from a calibration, which refuses a speed
    that needs hopping (above 4.4 with the default friction, 1.37 with a μ of 0.4)."""
    on_collision: OnCollision = "end"
    """What happens when two robots touch: the episode ends, or they push each other on. A robot
    that touches an obstacle always ends it: obstacles cannot be pushed against yet."""
    safety_margin: Annotated[float, tyro.conf.arg(metavar="M", help=SAFETY_MARGIN_HELP)] = 0.0
    time_limit: Annotated[float, tyro.conf.arg(metavar="S")] = TIMING.episode_limit_s
    """Simulated time in s after which an episode ends as a time-out."""

    def config(self) -> CoSimConfig:
        """See `Physics.config`."""
        config = super().config()
        return replace(
            config,
            timing=config.timing._replace(episode_limit_s=self.time_limit),
            steering=config.steering._replace(drive_speed_m_s=1e-3 * self.speed),
            on_collision=self.on_collision,
            safety_margin_m=self.safety_margin,
        )

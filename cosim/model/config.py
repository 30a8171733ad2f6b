"""The parameters of one co-simulation together, checked against each other."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import msgspec

from cosim.base.arguments import ConfigError, require_one_of, validate_argument
from cosim.model.params import (
    ESTIMATOR,
    SHIELD,
    SPEED_NOISE,
    STEERING,
    TABLE_I,
    TABLE_II,
    TIMING,
    EstimatorParams,
    MotorParams,
    NoiseParams,
    Quantity,
    RobotParams,
    ShieldParams,
    SteeringParams,
    TimingParams,
    describe,
    lift_off_speed,
    resized,
)
from cosim.model.world import IDEAL, World

OnCollision = Literal["end", "continue"]
Loop = Literal["motors", "heading"]

MAX_RATIO = 10**9  # of two periods
MAX_VALUE = 1e9  # of a parameter in its unit

# Sources of values.
UNKNOWN, GIVEN, OF_MOTOR = "unknown", "given", "given by motor_parameters"
_ROUNDING = 1e-9  # relative, of a period that shall be a multiple of another one
_RECORDS = ("robot", "motor", "noise", "timing", "steering", "estimator", "shield")
_SIGNED = ("com_x_m", "com_y_m")
_OPTIONS = {  # without `Quantity`, by their names in `CoSimConfig.table`
    "reaction": "whether motors feel the body's acceleration",
    "portable": "whether no angle is computed by the C library",
    "on_collision": "what a contact with a robot or an obstacle does",
    "through": "whether robots drive on at the end of a move until asked",
    "mu_patches": "cells with another mu",
    "payload_offset_mm": "forwards and to the left",
    "motor_phases_deg": "initial phases of the motors",
    "open_loop": "what goes without feedback",
    "preset": "machine that the parameters are of",
    "shield": "whether a monitor keeps robots apart, for any policy",
}


@dataclass(frozen=True)
class CoSimConfig:
    """Everything but the scenario and the FMU that determines a co-simulation.

    Attributes:
        robot: body, feet and floor; its diameter is the scenario's, see `sized`.
        motor: eccentric masses for Eq. (3), and parameters of the FMU where they differ from
            Table II.
        noise: of the speed measurement.
        timing: clock, decisions and limits.
        steering: speeds and gains.
        estimator: of the filter that robots see the camera through.
        reaction: whether the motors feel the acceleration of the body (the paper neglects it).
        portable: whether the angles that robots steer by have the same bits on every machine
            (`cosim.physics.trig`), or are those of the C library.
        on_collision: whether a robot that touches another one or an obstacle, or enters another
            one's target cell, ends the episode or pushes on.
        world: floor, motors, load and camera; `mu`, speed noise and obstacles are said elsewhere,
            see `in_world`.
        through: whether a robot drives on at the end of a move until it is asked, and turns only
            for another direction (the paper's stops).
        shield: what a monitor keeps that holds robots apart, for any policy
            (`cosim.onboard.shield`), and lets them yield to each other
            (`cosim.onboard.yielding`); None for no shield.
        open_loop: what goes without feedback: motors get the voltage that gives their set point in
            the mean instead of the loop of Eq. (14), and robots keep no course while they drive.
        preset: name of the machine, see `cosim.model`.
        sources: of parameters that were set, as (name, text), see `having`; UNKNOWN for one that
            the motor FMU does not expose. They do not matter for equality.
        motor_parameters: values that every motor FMU is given, by name, in addition to what differs
            between `motor` and Table II.
        motor_fmu: digest of the FMU that `motor` was read from (`cosim.coupling.parameters`); then
            only `motor_parameters` are set. Empty for the built-in FMU.

    Raises:
        ConfigError: a parameter is out of range or unknown, the robot's parts do not fit into its
            body, or a period is no multiple of the one below it.
    """

    robot: RobotParams = TABLE_I
    motor: MotorParams = TABLE_II
    noise: NoiseParams = SPEED_NOISE
    timing: TimingParams = TIMING
    steering: SteeringParams = STEERING
    estimator: EstimatorParams = ESTIMATOR
    reaction: bool = False
    portable: bool = False
    on_collision: OnCollision = "end"
    world: World = IDEAL
    through: bool = False
    shield: ShieldParams | None = None
    open_loop: tuple[Loop, ...] = ()
    preset: str = "paper"
    sources: tuple[tuple[str, str], ...] = field(default=(), compare=False)
    motor_parameters: tuple[tuple[str, float], ...] = ()
    motor_fmu: str = ""

    def __post_init__(self) -> None:
        require_one_of("on_collision", self.on_collision, get_args(OnCollision))
        for loop in self.open_loop:
            require_one_of("open_loop", loop, get_args(Loop))
        validate_argument("shield", self.shield, ShieldParams | None)
        for part in _RECORDS:
            record = getattr(self, part)
            if record is None:
                continue
            if any(type(value) is not float for value in record):
                record = type(record)(
                    *(validate_argument(n, v, float) for n, v in record._asdict().items())
                )
                object.__setattr__(self, part, record)
            for name, value in record._asdict().items():
                if name not in _SIGNED and not 0.0 <= value <= MAX_VALUE:
                    raise ConfigError(
                        f"{name} = {value} must be finite and not negative, at most {MAX_VALUE:g}"
                    )
        if self.shield and "heading" in self.open_loop:
            raise ConfigError(
                "the shield needs robots that keep their course; leave heading out of open_loop"
            )
        for record, names in (
            (self.robot, ("mass_kg", "diameter_m", "height_m", "com_height_m", "foot_radius_m")),
            (self.motor, ("m", "r", "K_T", "J", "R", "g")),
            (self.timing, ("dt_s", "communication_step_s", "control_period_s", "rl_step_s")),
            (self.steering, ("lookahead_m", "least_lookahead_m")),
        ):
            for name in names:
                if getattr(record, name) == 0.0:
                    raise ConfigError(f"{name} must be positive")
        self._check_geometry()
        step_s = self.timing.communication_step_s
        whole_ratio("communication_step_s", step_s, "dt_s", self.timing.dt_s)
        whole_ratio(
            "control_period_s", self.timing.control_period_s, "communication_step_s", step_s
        )
        whole_ratio(
            "rl_step_s", self.timing.rl_step_s, "control_period_s", self.timing.control_period_s
        )
        whole_ratio("hold_s", self.noise.hold_s, "control_period_s", self.timing.control_period_s)
        limit = self.lift_off_rad_s
        for name in (
            "forward_speed_rad_s",
            "backward_speed_rad_s",
            "turn_speed_rad_s",
            "max_speed_rad_s",
        ):
            speed = getattr(self.steering, name)
            if speed >= limit:
                raise ConfigError(
                    f"{name} = {speed:g} rad/s would make the robot hop; "
                    f"stay below lift-off at {limit:.0f} rad/s"
                )

    def _check_geometry(self) -> None:
        robot = self.robot
        inside_m = robot.foot_radius_m / 2.0  # of the triangle of feet
        if not math.hypot(robot.com_x_m, robot.com_y_m) < inside_m:
            raise ConfigError(
                f"com_x_m = {robot.com_x_m:g} and com_y_m = {robot.com_y_m:g} make the robot fall "
                f"over; stay less than {inside_m:g} from its axis"
            )
        payload_kg, offset_mm = 1e-3 * self.world.payload_g, self.world.payload_offset_mm
        mass_kg = robot.mass_kg + payload_kg
        ahead_m, left_m = (
            (robot.mass_kg * own_m + 1e-3 * payload_kg * mm) / mass_kg
            for own_m, mm in zip((robot.com_x_m, robot.com_y_m), offset_mm, strict=True)
        )
        if not math.hypot(ahead_m, left_m) < inside_m:
            raise ConfigError(
                f"world.payload_g = {self.world.payload_g:g} at payload_offset_mm = "
                f"{list(offset_mm)} moves the centre of mass "
                f"{1e3 * math.hypot(ahead_m, left_m):.1f} mm from the robot's axis, which falls "
                f"over from {1e3 * inside_m:.1f} mm on; give a lighter payload or a smaller offset"
            )
        for name in ("foot_radius_m", "motor_radius_m"):
            if getattr(robot, name) >= robot.diameter_m / 2.0:
                raise ConfigError(
                    f"{name} = {getattr(robot, name):g} lies outside a robot of diameter_m = "
                    f"{robot.diameter_m:g}; make it less than half of that"
                )
        if robot.motor_radius_m <= robot.motor_length_m / 2.0:
            raise ConfigError(
                f"two motors of motor_length_m = {robot.motor_length_m:g} do not fit next to each "
                f"other at motor_radius_m = {robot.motor_radius_m:g} into a robot of diameter_m = "
                f"{robot.diameter_m:g}; make the robot larger"
            )

    def having(self, source: str, **values: Any) -> "CoSimConfig":
        """Return a copy in which parameters have other values, recorded with their source.

        Args:
            source: of all these values.
            values: of fields of the records or of the configuration, by name; None keeps one.
        """
        given = {name: value for name, value in values.items() if value is not None}
        changed = dict(given)
        for part in _RECORDS:
            record = getattr(self, part)
            own = {n: changed.pop(n) for n in getattr(record, "_fields", ()) if n in changed}
            if own:
                changed[part] = record._replace(**own)
        sources = dict(self.sources) | dict.fromkeys(given, source)
        return replace(self, **changed, sources=tuple(sources.items()))

    def sourced(self, sources: Mapping[str, str]) -> "CoSimConfig":
        """Return a copy with further sources of parameters, or other ones, by name."""
        return replace(self, sources=tuple({**dict(self.sources), **sources}.items()))

    @property
    def unsourced(self) -> "CoSimConfig":
        """This configuration without sources, for digests: they decide no result."""
        return replace(self, sources=())

    def sized(self, diameter_m: float) -> "CoSimConfig":
        """Return these parameters for robots of another diameter, see `resized`.

        To be called before a calibration: motor speeds depend on the robot's inertia.
        """
        robot = resized(self.robot, diameter_m)
        if robot == self.robot:
            return self
        feet = {n: getattr(robot, n) for n in ("foot_radius_m", "motor_radius_m")}
        own = self.having("in proportion to the diameter", **feet, diameter_m=diameter_m)
        return own.sourced({"diameter_m": "scenario"})

    def in_world(self, world: World) -> "CoSimConfig":
        """Return these parameters in a world as declared.

        To be called before a calibration: robots are calibrated on the floor and with the load that
        they will have.
        """
        rest = msgspec.structs.replace(world, mu=None, motor_speed_noise=None, obstacles=())
        config = self.having("world", mu=world.mu, relative_amplitude=world.motor_speed_noise)
        kept = {n: text for n, text in config.sources if n not in self.world.stated}
        sources = kept | dict.fromkeys(world.stated, "world")
        return replace(config, world=rest, sources=tuple(sources.items()))

    def require_known(self, what: str, *names: str) -> None:
        """Refuse motors of which a parameter is unknown."""
        lacking = [n for n, text in self.sources if text.startswith(UNKNOWN) and n in names]
        if lacking:
            raise ConfigError(
                f"the motor FMU does not expose {', '.join(lacking)}, which {what} needs; "
                "export it with them"
            )

    @property
    def lift_off_rad_s(self) -> float:
        """Motor speed that lifts the robot with its payload off a level floor."""
        mass_kg = self.robot.mass_kg + 1e-3 * self.world.payload_g
        return lift_off_speed(self.robot._replace(mass_kg=mass_kg), self.motor)

    @property
    def ticks_per_step(self) -> int:
        """Ticks of dt per communication step."""
        return round(self.timing.communication_step_s / self.timing.dt_s)

    @property
    def ticks_per_period(self) -> int:
        """Ticks of dt per control period."""
        return round(self.timing.control_period_s / self.timing.dt_s)

    def ticks(self, duration_s: float) -> int:
        """Least number of ticks of dt that is no shorter than a duration in s, but for rounding."""
        return math.ceil(duration_s / self.timing.dt_s * (1.0 - _ROUNDING))

    @property
    def periods_per_step(self) -> int:
        """Control periods per RL step."""
        return round(self.timing.rl_step_s / self.timing.control_period_s)

    @property
    def periods_per_noise_value(self) -> int:
        """Number of control periods of one noise value."""
        return round(self.noise.hold_s / self.timing.control_period_s)

    def table(self) -> dict[str, dict[str, Any]]:
        """Return value, unit, source and description of every parameter, by its name.

        A value without a recorded source that differs from the default is "given".
        """
        usual, sources, rows = CoSimConfig().described(), dict(self.sources), {}
        for name, (value, quantity) in self.described().items():
            changed = name in usual and value != usual[name][0]
            source = sources.get(name, GIVEN if changed else quantity.source)
            shown = UNKNOWN if source == UNKNOWN else value
            rows[name] = {"value": shown} | quantity._replace(source=source)._asdict()
        return rows

    def described(self) -> dict[str, tuple[Any, Quantity]]:
        """Return value and `Quantity` of every parameter, by its name."""
        records = [getattr(self, part) or SHIELD for part in _RECORDS]
        rows = {
            n: row for part in (*records, self.world.filled()) for n, row in describe(part).items()
        }
        rows |= {f"sensor_{name}": row for name, row in describe(self.world.camera).items()}
        for name, value in self.motor_parameters:
            rows.setdefault(name, (value, Quantity("", OF_MOTOR, "of the motor FMU")))
        own = msgspec.json.decode(msgspec.json.encode(self.world)) | vars(self)
        own |= {"open_loop": " ".join(self.open_loop), "shield": self.shield is not None}
        for name, text in _OPTIONS.items():
            rows[name] = own[name], Quantity("", "default", text)
        return rows


def whole_ratio(name: str, period: float, base_name: str, base: float) -> int:
    """The ratio period/base as the whole number it must be."""
    ratio = round(min(period / base, MAX_RATIO))
    if ratio < 1 or ratio == MAX_RATIO or abs(period - ratio * base) > _ROUNDING * period:
        raise ConfigError(
            f"{name} = {period:g} s is not a whole multiple of {base_name} = {base:g} s; change one"
        )
    return ratio

"""The parameters of one co-simulation together, checked against each other.

Machines, worlds and options are partial trees: values and their sources by the parameters' names.
They are merged, later ones over earlier ones, and what comes of that is validated once.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal, NamedTuple

import msgspec

from cosim.base.arguments import ConfigError, validate_fields
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
)
from cosim.model.world import IDEAL, Tree, World, parameter_name, tree_of

OnCollision = Literal["end", "continue"]
Loop = Literal["motors", "heading"]

MAX_RATIO = 10**9  # of two periods

# Sources of values.
UNKNOWN, GIVEN, OF_MOTOR = "unknown", "given", "given by motor_parameters"
_ROUNDING = 1e-9  # relative, of a period that shall be a multiple of another one
_RECORDS = ("robot", "motor", "noise", "timing", "steering", "estimator", "shield")


def _option(description: str) -> Quantity:
    return Quantity("", "default", description)


class Leaf(NamedTuple):
    """A parameter: where it is in the configuration, its value, and its unit and source."""

    path: str
    value: Any
    quantity: Quantity

    def __str__(self) -> str:
        value = "none" if self.value in ("", [], None) else self.value
        unit = "" if self.quantity.unit == "1" else self.quantity.unit
        return f"{self.path} = {value} {unit}".rstrip() + f"  ({self.quantity.source})"

    def table(self) -> dict[str, Any]:
        """Return value, unit, source and description by name."""
        return {"value": self.value} | self.quantity._asdict()


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
        reaction: the paper neglects it.
        portable: see `cosim.physics.trig`.
        on_collision: as does entering another robot's target cell: end the episode, or push on.
        world: floor, motors, load and camera; its `mu` and speed noise are in `robot` and `noise`,
            its obstacles in the scenario.
        through: they turn only for another direction; the paper's stop.
        shield: distances that it keeps (`cosim.onboard.shield`); robots yield to each other, too
            (`cosim.onboard.yielding`). None for no shield.
        open_loop: motors get the voltage that gives their set point in the mean instead of the loop
            of Eq. (14), and robots keep no course while they drive.
        preset: see `cosim.model.preset`.
        sources: of parameters that were set, as (name, text), see `merged`; UNKNOWN for one that
            the motor FMU does not expose. They do not matter for equality.
        motor_parameters: values that every motor FMU is given, by name, in addition to what differs
            between `motor` and Table II.
        motor_fmu: digest of the FMU that `motor` was read from (`cosim.fmi.motor`); then
            only `motor_parameters` are set. Empty for the built-in FMU.
    """

    robot: RobotParams = TABLE_I
    motor: MotorParams = TABLE_II
    noise: NoiseParams = SPEED_NOISE
    timing: TimingParams = TIMING
    steering: SteeringParams = STEERING
    estimator: EstimatorParams = ESTIMATOR
    reaction: Annotated[bool, _option("whether motors feel the body's acceleration")] = False
    portable: Annotated[bool, _option("whether no angle is computed by the C library")] = False
    on_collision: Annotated[
        OnCollision, _option("what a contact with a robot or an obstacle does")
    ] = "end"
    world: World = IDEAL
    through: Annotated[
        bool, _option("whether robots drive on at the end of a move until asked")
    ] = False
    shield: Annotated[
        ShieldParams | None, _option("whether a monitor keeps robots apart, for any policy")
    ] = None
    open_loop: Annotated[tuple[Loop, ...], _option("what goes without feedback")] = ()
    preset: Annotated[str, _option("machine that the parameters are of")] = "paper"
    sources: tuple[tuple[str, str], ...] = field(default=(), compare=False)
    motor_parameters: tuple[tuple[str, float], ...] = ()
    motor_fmu: str = ""

    def __post_init__(self) -> None:
        validate_fields(self)
        if self.shield and "heading" in self.open_loop:
            raise ConfigError(
                "the shield needs robots that keep their course; leave heading out of open_loop"
            )
        self._check_geometry()
        timing = self.timing._asdict() | self.noise._asdict()
        for name, base in (
            ("communication_step_s", "dt_s"),
            ("control_period_s", "communication_step_s"),
            ("rl_step_s", "control_period_s"),
            ("hold_s", "control_period_s"),
        ):
            whole_ratio(name, timing[name], base, timing[base])
        limit = self.lift_off_rad_s
        for name, speed in self.steering._asdict().items():
            if name.endswith("_speed_rad_s") and speed >= limit:
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
        moved_m = math.hypot(
            *(
                (robot.mass_kg * own_m + 1e-3 * payload_kg * mm) / mass_kg
                for own_m, mm in zip((robot.com_x_m, robot.com_y_m), offset_mm, strict=True)
            )
        )
        if not moved_m < inside_m:
            raise ConfigError(
                f"world.payload_g = {self.world.payload_g:g} at payload_offset_mm = "
                f"{list(offset_mm)} moves the centre of mass {1e3 * moved_m:.1f} mm from the "
                f"robot's axis, which falls over from {1e3 * inside_m:.1f} mm on; give a lighter "
                "payload or a smaller offset"
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

    def merged(self, *trees: Mapping[str, tuple[Any, str]]) -> "CoSimConfig":
        """Return a copy with the values of partial trees and their sources, later ones first."""
        tree = {name: leaf for each in trees for name, leaf in each.items()}
        values: dict[str, Any] = {name: value for name, (value, _) in tree.items()}
        changed: dict[str, Any] = {}
        for part in _RECORDS:
            record = getattr(self, part)
            own = {n: values.pop(n) for n in getattr(record, "_fields", ()) if n in values}
            if own:
                changed[part] = record._replace(**own)
        for table, record in (("world.sensor", self.world.camera), ("world", self.world)):
            names = {parameter_name(table, n): n for n in record.__struct_fields__}
            own = {names[n]: values.pop(n) for n in names.keys() & values.keys()}
            if own:
                of = changed if table == "world" else values
                of[table.rpartition(".")[2]] = msgspec.structs.replace(record, **own)
        sources = tuple((dict(self.sources) | {n: text for n, (_, text) in tree.items()}).items())
        return replace(self, **changed, **values, sources=sources)

    def having(self, source: str, /, **values: Any) -> "CoSimConfig":
        """Return a copy in which parameters have other values of one source; None keeps one."""
        return self.merged(tree_of(source, **values))

    @property
    def unsourced(self) -> "CoSimConfig":
        """This configuration without sources, for digests: they decide no result."""
        return replace(self, sources=())

    def sized(self, diameter_m: float) -> "CoSimConfig":
        """Return these parameters for robots of another diameter, feet and motors near its rim.

        To be called before a calibration: motor speeds depend on the robot's inertia.
        """
        robot = self.robot
        if robot.diameter_m == diameter_m:
            return self
        scale = diameter_m / robot.diameter_m
        feet = {n: scale * getattr(robot, n) for n in ("foot_radius_m", "motor_radius_m")}
        own = tree_of("scenario", diameter_m=diameter_m)
        return self.merged(tree_of("in proportion to the diameter", **feet), own)

    def in_world(self, world: World) -> "CoSimConfig":
        """Return these parameters in another world, as declared.

        To be called before a calibration: robots are calibrated on the floor and with the load that
        they will have.
        """
        left = self.world.tree()
        kept = tuple((name, text) for name, text in self.sources if name not in left)
        return replace(self, world=IDEAL, sources=kept).merged(world.tree())

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

    def leaves(self) -> dict[str, Leaf]:
        """Return every parameter by its name, with its own source.

        A value without a recorded source that differs from the default is "given".
        """
        usual, sources = CoSimConfig()._declared(), dict(self.sources)
        found = {}
        for name, (path, value, quantity) in self._declared().items():
            changed = name in usual and value != usual[name].value
            source = sources.get(name, GIVEN if changed else quantity.source)
            found[name] = Leaf(
                path, UNKNOWN if source == UNKNOWN else value, quantity._replace(source=source)
            )
        return found

    def table(self) -> dict[str, dict[str, Any]]:
        """Return value, unit, source and description of every parameter, by its name."""
        return {name: leaf.table() for name, leaf in self.leaves().items()}

    def _declared(self) -> dict[str, Leaf]:
        """Return every parameter by its name, with the sources of defaults; values as in JSON."""
        tables: dict[str, Any] = {part: getattr(self, part) or SHIELD for part in _RECORDS}
        tables |= {"world": self.world, "world.sensor": self.world.camera, "": self}
        rows = {
            parameter_name(table, n): Leaf(f"{table}.{n}".removeprefix("."), value, quantity)
            for table, record in tables.items()
            for n, (value, quantity) in describe(record).items()
        }
        for name, value in self.motor_parameters:
            quantity = Quantity("", OF_MOTOR, "of the motor FMU")
            rows.setdefault(name, Leaf(f"motor_parameters.{name}", value, quantity))
        changed = {"open_loop": " ".join(self.open_loop), "shield": bool(self.shield)}
        for name, leaf in rows.items():
            value = changed.get(name, 0.0 if leaf.value is None else leaf.value)
            rows[name] = leaf._replace(value=msgspec.json.decode(msgspec.json.encode(value)))
        return rows


def proportional(steering: SteeringParams, share: float) -> Tree:
    """Return a share of the motor speeds of the steering."""
    speeds = {n: share * v for n, v in steering._asdict().items() if n.endswith("_speed_rad_s")}
    return tree_of("computed: in proportion to lift-off", **speeds)


def whole_ratio(name: str, period: float, base_name: str, base: float) -> int:
    """The ratio period/base as the whole number it must be."""
    ratio = round(min(period / base, MAX_RATIO))
    if ratio < 1 or ratio == MAX_RATIO or abs(period - ratio * base) > _ROUNDING * period:
        raise ConfigError(
            f"{name} = {period:g} s is not a whole multiple of {base_name} = {base:g} s; change one"
        )
    return ratio

"""The parameters of one co-simulation together, checked against each other.

Machines, worlds and options are partial trees: values and their sources by the parameters' names.
They are merged, later ones over earlier ones, and what comes of that is validated once.
"""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal, NamedTuple

import msgspec

from cosim.base.arguments import ConfigError, validate_fields
from cosim.base.provenance import digest_of
from cosim.model import params
from cosim.model.scenario import Scenario
from cosim.model.world import IDEAL, Tree, World, parameter_name, tree_of

OnCollision = Literal["end", "continue"]
Loop = Literal["motors", "heading"]

MAX_RATIO = 10**9  # of two periods
# Of a cantilever: the load at which it buckles, π²/12 over bending stiffness and length
BUCKLING = math.pi**2 / 12.0
MOST_SAG = 0.2  # of a leg's length: beyond, deflections are not small

# Sources of values.
UNKNOWN, GIVEN, OF_MOTOR = "unknown", "given", "given by motor_parameters"
_ROUNDING = 1e-9  # relative, of a period that shall be a multiple of another one
_STEERING = params.SteeringParams._fields
_RECORDS = ("robot", "motor", "noise", "timing", "steering", "estimator", "shield")


def _option(description: str) -> params.Quantity:
    return params.Quantity("", "default", description)


class Leaf(NamedTuple):
    """A parameter: where it is in the configuration, its value, and its unit and source."""

    path: str
    value: Any
    quantity: params.Quantity

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
        robot: body, motors, feet and floor; its diameter is the scenario's, see `sized`.
        motor: eccentric masses for Eq. (3), and parameters of the FMU where they differ from
            Table II.
        on_collision: as does entering another robot's target cell: end the episode, or push on.
        world: floor, motors, load and camera; its `mu` and speed noise are in `robot` and `noise`,
            its obstacles in the scenario.
        through: they turn only for another direction; the paper's stop.
        shield: distances that it keeps (`cosim.onboard.shield`); robots yield to each other, too
            (`cosim.onboard.yielding`). None for no shield.
        open_loop: motors get the voltage that gives their set point in the mean instead of the loop
            of Eq. (14), and robots keep no course while they drive.
        sources: of parameters that were set, as (name, text), see `merged`; UNKNOWN for one that
            the motor FMU does not expose. They do not matter for equality.
        motor_parameters: values that every motor FMU is given, by name, in addition to what differs
            between `motor` and Table II.
        motor_fmu: digest of the FMU that `motor` was read from (`cosim.fmi.motor`); then
            only `motor_parameters` are set. Empty for the built-in FMU.
    """

    robot: params.RobotParams = params.TABLE_I
    motor: params.MotorParams = params.TABLE_II
    noise: params.NoiseParams = params.SPEED_NOISE
    timing: params.TimingParams = params.TIMING
    steering: params.SteeringParams = params.STEERING
    estimator: params.EstimatorParams = params.ESTIMATOR
    reaction: Annotated[bool, _option("whether motors feel the body's acceleration")] = False
    on_collision: Annotated[
        OnCollision, _option("what a contact with a robot or an obstacle does")
    ] = "end"
    world: World = IDEAL
    through: Annotated[
        bool, _option("whether robots drive on at the end of a move until asked")
    ] = False
    shield: Annotated[
        params.ShieldParams | None, _option("whether a monitor keeps robots apart, for any policy")
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
        self._check_pulses()
        limit = self.limit_rad_s
        for name, speed in self.steering._asdict().items():
            if name.endswith("_speed_rad_s") and speed >= limit:
                raise ConfigError(
                    f"{name} = {speed:g} rad/s would make the robot hop; "
                    f"stay below lift-off at {limit:.0f} rad/s"
                )

    def _check_pulses(self) -> None:
        steering, period_s = self.steering, self.timing.control_period_s
        if steering.pause_s and not steering.pulse_s:
            raise ConfigError(
                f"pause_s = {steering.pause_s:g} has no effect without pulses; give pulse_s, too, "
                "or leave it out"
            )
        for name in ("pulse_s", "pause_s"):
            if value := getattr(steering, name):
                whole_ratio(name, value, "control_period_s", period_s)

    def _check_masses(self) -> None:
        robot = self.robot
        if robot.inertia_kg_m2:
            moments = sorted(robot.inertia_kg_m2)
            given = f"inertia_kg_m2 = {list(robot.inertia_kg_m2)}"
            if len(moments) != 3:
                raise ConfigError(f"{given} has {len(moments)} moments; give Ixx, Iyy and Izz")
            if moments[2] > (moments[0] + moments[1]) * (1.0 + _ROUNDING):
                raise ConfigError(
                    f"{given} is of no body: each moment is at most the sum of the two others; "
                    "change one"
                )
        if robot.com_height_m > robot.height_m:
            raise ConfigError(
                f"com_height_m = {robot.com_height_m:g} is above the body of height_m = "
                f"{robot.height_m:g}; make it lower, or the body higher"
            )
        eccentric_kg = sum(own.m for own in params.motors_of(robot, self.motor))
        if robot.masses_included and eccentric_kg >= robot.mass_kg:
            raise ConfigError(
                f"mass_kg = {robot.mass_kg:g} is of the whole machine, but the eccentric masses of "
                f"its motors have {eccentric_kg:g} together; weigh it with them, or give "
                "masses_included = false"
            )

    def _check_geometry(self) -> None:
        robot, steering = self.robot, self.steering
        counts = [len(steering.shares), *(len(drive.difference) for drive in steering.drives)]
        if set(counts) != {len(robot.motors)}:
            raise ConfigError(
                f"the steering is one of {len(steering.shares)} motors, but the machine has "
                f"{len(robot.motors)}"
            )
        self._check_masses()
        self._check_places()
        self._check_legs()

    def _check_places(self) -> None:
        """Refuse motors and feet outside the body, and feet on which it falls over."""
        robot, limit_m = self.robot, self.robot.diameter_m / 2.0
        places = [("foot", foot.x_m, foot.y_m) for foot in robot.feet]
        places += [("motor", *mount.place_m[:2]) for mount in robot.motors]
        for name, x, y in places:
            if math.hypot(x, y) > limit_m:
                raise ConfigError(
                    f"a {name} at ({x:g}, {y:g}) m is outside the body of diameter_m = "
                    f"{robot.diameter_m:g}; move it inwards, or make the body larger"
                )
        for mount in robot.motors:
            if not 0.0 <= mount.place_m[2] <= robot.height_m:
                raise ConfigError(
                    f"a motor has place_m[2] = {mount.place_m[2]:g} above the floor, which is "
                    f"outside a body of height_m = {robot.height_m:g}; give 0 to that"
                )
        if "mu" in dict(self.sources) and all(foot.mu is not None for foot in robot.feet):
            raise ConfigError(
                f"mu = {robot.mu:g} has no effect: every foot of this machine has its own; leave "
                "it out, or take mu out of the tables [[foot]]"
            )
        x, y = self.centre_of_mass_m
        angles = sorted(math.atan2(foot.y_m - y, foot.x_m - x) for foot in robot.feet)
        gaps = [b - a for a, b in itertools.pairwise([*angles, angles[0] + 2.0 * math.pi])]
        if max(gaps) >= math.pi * (1.0 - 1e-6):
            raise ConfigError(
                f"the machine falls over: its centre of mass, with the payload at ({1e3 * x:.3g}, "
                f"{1e3 * y:.3g}) mm from its axis, is not between its {len(robot.feet)} feet; "
                "move a foot or the centre of mass, or give a lighter payload"
            )

    def _check_legs(self) -> None:
        """Refuse elastic legs that the law of contact does not describe."""
        legs = [foot.leg for foot in self.robot.feet if foot.leg is not None]
        if not legs:
            return
        if len(legs) < len(self.robot.feet):
            raise ConfigError("some feet are rigid and others elastic; make all of them one kind")
        if self.world.restitution:
            raise ConfigError(
                f"restitution = {self.world.restitution:g} has no effect on elastic feet, which "
                "rebound by their own stiffness and damping; leave it out"
            )
        weight = (self.robot.mass_kg + 1e-3 * self.world.payload_g) * self.motor.g
        sag_m = weight / sum(leg.upright_n_m for leg in legs)
        for leg in legs:
            load, limit = sag_m * leg.upright_n_m, BUCKLING * leg.bending_n_m * leg.length_m
            if load >= limit or sag_m >= MOST_SAG * leg.length_m:
                fault = "buckle" if load >= limit else "sag too far for linear beams"
                raise ConfigError(
                    f"legs of length_m = {leg.length_m:g} {fault}: one carries {1e3 * load:.3g} of "
                    f"at most {1e3 * limit:.3g} mN, and gives way by {1e3 * sag_m:.2g} of at most "
                    f"{1e3 * MOST_SAG * leg.length_m:.2g} mm; make them stiffer or more, or the "
                    "machine lighter"
                )

    @property
    def hops(self) -> bool:
        """Whether feet may leave the floor while driving: of pulsed motors, and on elastic legs."""
        return self.steering.pulse_s > 0.0 or self.robot.elastic

    @property
    def centre_of_mass_m(self) -> tuple[float, float]:
        """Place of the centre of mass with the payload, from the robot's axis."""
        payload_kg, own_kg = 1e-3 * self.world.payload_g, self.robot.mass_kg
        own_m = self.robot.com_x_m, self.robot.com_y_m
        x, y = (
            (own_kg * own + 1e-3 * payload_kg * mm) / (own_kg + payload_kg)
            for own, mm in zip(own_m, self.world.payload_offset_mm, strict=True)
        )
        return x, y

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
        """Return these parameters for robots of another diameter, feet and motors in proportion.

        Heights stay. To be called before a calibration: motor speeds depend on the robot's inertia.
        """
        if self.robot.diameter_m == diameter_m:
            return self
        robot = self.robot.spread(diameter_m / self.robot.diameter_m)
        places = tree_of("in proportion to the diameter", motors=robot.motors, feet=robot.feet)
        return self.merged(places, tree_of("scenario", diameter_m=diameter_m))

    def in_world(self, world: World) -> "CoSimConfig":
        """Return these parameters in another world, as declared.

        To be called before a calibration: robots are calibrated on the floor and with the load that
        they will have.
        """
        left = self.world.tree()
        kept = tuple((name, text) for name, text in self.sources if name not in left)
        return replace(self, world=IDEAL, sources=kept).merged(world.tree())

    def move_limit_s(self, cell_m: float) -> float:
        """Return the time in s after which a move between cells with an edge of `cell_m` ends.

        It is `timing.move_limit_s`, and longer in proportion where moves need longer than those of
        the paper's robot on its cells.
        """
        if not self.steering.given:  # motors get set points: there are no moves
            return self.timing.move_limit_s
        usual_s = _longest_move_s(params.STEERING, Scenario.cell_m)
        share = _longest_move_s(self.steering, cell_m) / usual_s
        return self.timing.move_limit_s * max(1.0, share)

    @property
    def lift_off_rad_s(self) -> float:
        """Motor speed that lifts the robot with its payload off a level floor."""
        mass_kg = self.robot.mass_kg + 1e-3 * self.world.payload_g
        return params.lift_off_speed(self.robot._replace(mass_kg=mass_kg), self.motor)

    @property
    def limit_rad_s(self) -> float:
        """Motor speed that set points stay below: lift-off, if feet may not leave the floor."""
        return math.inf if self.hops else self.lift_off_rad_s

    @property
    def top_speeds_rad_s(self) -> tuple[float, ...]:
        """Largest set point of each motor: what it can reach, below the limit of all."""
        motors = params.motors_of(self.robot, self.motor)
        return tuple(min(params.voltage_speed(own), self.limit_rad_s) for own in motors)

    @property
    def top_speed_rad_s(self) -> float:
        """Largest set point of any motor."""
        return max(self.top_speeds_rad_s)

    @property
    def machine_digest(self) -> str:
        """Hash (16 hex digits) of the machine and its motors; not of the friction of the floor."""
        own = self.robot._replace(mu=0.0), self.motor, self.motor_parameters, self.motor_fmu
        return digest_of(*own)

    @property
    def commanded(self) -> "CoSimConfig":
        """These parameters for robots whose motors get set points, which needs no calibration.

        The largest one is the share of the top speed that it is for the paper's robot; the scales
        of velocities are that robot's.
        """
        usual, share = params.STEERING, self.top_speed_rad_s / CoSimConfig().top_speed_rad_s
        scales = {n: getattr(usual, n) for n in ("drive_speed_m_s", "turn_rate_rad_s")}
        most = tree_of(
            "computed: in proportion to the top speed",
            max_speed_rad_s=usual.max_speed_rad_s * share,
        )
        return self.merged(most, tree_of("as of the paper's robot", **scales))

    @property
    def voltage_driven(self) -> bool:
        """Whether motors get voltages instead of set points of Eq. (14)."""
        return "motors" in self.open_loop or self.steering.pulse_s > 0.0

    @property
    def ticks_per_step(self) -> int:
        """Ticks of dt per communication step."""
        return round(self.timing.communication_step_s / self.timing.dt_s)

    @property
    def ticks_per_period(self) -> int:
        """Ticks of dt per control period."""
        return round(self.timing.control_period_s / self.timing.dt_s)

    def ticks(self, duration_s: float) -> int:
        """Return the least number of ticks of dt that lasts a duration in s, up to rounding."""
        return math.ceil(duration_s / self.timing.dt_s * (1.0 - _ROUNDING))

    @property
    def periods_per_step(self) -> int:
        """Control periods per RL step."""
        return round(self.timing.rl_step_s / self.timing.control_period_s)

    def leaves(self) -> dict[str, Leaf]:
        """Return every parameter by name with its source; "given" if changed without a record."""
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
        tables: dict[str, Any] = {part: getattr(self, part) or params.SHIELD for part in _RECORDS}
        tables |= {"world": self.world, "world.sensor": self.world.camera, "": self}
        rows = {
            parameter_name(table, n): Leaf(f"{table}.{n}".removeprefix("."), value, quantity)
            for table, record in tables.items()
            for n, (value, quantity) in params.describe(record).items()
        }
        for name, value in self.motor_parameters:
            quantity = params.Quantity("", OF_MOTOR, "of the motor FMU")
            rows.setdefault(name, Leaf(f"motor_parameters.{name}", value, quantity))
        changed = {"open_loop": " ".join(self.open_loop), "shield": bool(self.shield)}
        for name, leaf in rows.items():
            value = changed.get(name, 0.0 if leaf.value is None else leaf.value)
            rows[name] = leaf._replace(value=msgspec.json.decode(msgspec.json.encode(value)))
        return rows


def proportional(steering: params.SteeringParams, share: float) -> Tree:
    """Return a share of the motor speeds of the steering."""
    speeds = {n: share * v for n, v in steering._asdict().items() if n.endswith("_speed_rad_s")}
    return tree_of("computed: in proportion to lift-off", **speeds)


def not_calibrated(motors: int) -> Tree:
    """Return the steering of a machine whose shares are to be found, which moves no motor.

    It asks for no speed: the machine drives and turns as its primitives are found.
    """
    names = [n for n in _STEERING if n.endswith("_speed_rad_s")]
    speeds = dict.fromkeys((*names, "drive_speed_m_s", "turn_rate_rad_s"), 0.0)
    shares = (params.MotorShares(),) * motors
    drives = (params.Drive(difference=(0.0,) * motors),) * 4
    return tree_of("not calibrated", **speeds, shares=shares, drives=drives)


def _longest_move_s(steering: params.SteeringParams, cell_m: float) -> float:
    """Return the time that a diagonal move after the largest turn needs."""
    half_turns = 1.0 if steering.backward_speed_rad_s <= 0.0 else 0.5
    turn_s = half_turns * math.pi / steering.turn_rate_rad_s
    return turn_s + math.sqrt(2.0) * cell_m / steering.drive_speed_m_s


def whole_ratio(name: str, period: float, base_name: str, base: float) -> int:
    """The ratio period/base as the whole number it must be."""
    ratio = round(min(period / base, MAX_RATIO))
    if ratio < 1 or ratio == MAX_RATIO or abs(period - ratio * base) > _ROUNDING * period:
        raise ConfigError(
            f"{name} = {period:g} s is not a whole multiple of {base_name} = {base:g} s; change one"
        )
    return ratio

"""Tables I and II of the paper and everything assumed: the only physical literals of the project.

Every field of a configuration has its range as a type, and its unit, source and description as a
`Quantity`; `describe` lists these for help texts, recordings and the FMU's variable table. Derived
quantities are functions. SI units and radians throughout. Records are NamedTuples because numba
kernels read them.
"""

import math
from typing import Annotated, Any, Literal, NamedTuple, get_type_hints

from msgspec import Meta

MAX_MOTORS, MAX_FEET = 8, 32  # of a machine
MAX_VALUE = 1e9  # of a parameter in its unit
Positive = Annotated[float, Meta(gt=0.0, le=MAX_VALUE)]
Amount = Annotated[float, Meta(ge=0.0, le=MAX_VALUE)]
Share = Annotated[float, Meta(ge=-1.0, le=1.0)]
Lean = Annotated[float, Meta(ge=0.0, le=60.0)]  # of a leg, in degrees
Turn = Annotated[float, Meta(ge=-360.0, le=360.0)]  # in degrees


class Quantity(NamedTuple):
    """Unit, source and meaning of a parameter."""

    unit: str
    source: str
    description: str


class MotorParams(NamedTuple):
    """Vibration motor and its PI speed loop (Table II, Eq. 13 and 14), in the paper's symbols."""

    m: Annotated[Positive, Quantity("kg", "Table II", "motor eccentric mass")] = 0.00021
    r: Annotated[Positive, Quantity("m", "Table II", "eccentricity of the rotating mass")] = 0.00177
    K_T: Annotated[Positive, Quantity("N.m/A", "Table II", "torque constant")] = 3.64e-4
    J: Annotated[Positive, Quantity("kg.m2", "Table II", "eccentric load's moment of inertia")] = (
        2.67e-9
    )
    R: Annotated[Positive, Quantity("Ohm", "Table II", "motor electrical resistance")] = 10.7
    b: Annotated[
        Amount,
        Quantity("N.m.s/rad", "Table II (printed Ns/m, read as rotational)", "viscous friction"),
    ] = 2.94e-9
    c: Annotated[Amount, Quantity("N.m", "Table II", "Coulomb friction torque")] = 1.34e-5
    g: Annotated[Positive, Quantity("m/s2", "Table II", "gravitational acceleration")] = 9.81
    K_p: Annotated[Amount, Quantity("V.s/rad", "Table II", "proportional gain")] = 0.015
    K_i: Annotated[Amount, Quantity("V/rad", "Table II", "integral gain")] = 0.025
    V_s_max: Annotated[Amount, Quantity("V", "Table II", "maximum input voltage")] = 3.0


Place = tuple[float, float, float]


class Mount(NamedTuple):
    """Where a motor is on the body, seen from the robot's axis on the floor."""

    place_m: Place
    axis: Place  # along the shaft, unit vector: it turns counter-clockwise seen from its tip
    own: tuple[tuple[str, float], ...] = ()  # parameters that are stated of this motor


class Leg(NamedTuple):
    """A leg that bends, from the body to the tip that touches the floor, or a bundle of them."""

    lean_deg: Lean  # from the vertical
    lean_towards_deg: Turn  # direction from root to tip on the floor, counter-clockwise from +x
    axial_n_m: Positive  # stiffness along the leg
    bending_n_m: Positive  # stiffness across it, at the tip
    relaxation_s: Positive  # damping over stiffness
    length_m: Positive

    @property
    def upright_n_m(self) -> float:
        """Stiffness against a load from above on a tip that slides without friction."""
        down = math.cos(math.radians(self.lean_deg)) ** 2
        return 1.0 / (down / self.axial_n_m + (1.0 - down) / self.bending_n_m)


class Foot(NamedTuple):
    """Where a foot touches the floor, seen from the robot's axis, its friction, and its leg."""

    x_m: float
    y_m: float
    mu: float | None = None  # None: that of the robot
    leg: Leg | None = None  # None: rigid; else the foot is where the tip of the straight leg is


class RobotParams(NamedTuple):
    """Rigid body, feet, motor mounts and floor friction of one robot (Table I and assumed).

    Motors and feet are in the order of the machine's file; defaults are those of Fig. 4b. With
    `masses_included`, mass, centre of mass and inertia are those of the whole machine, eccentric
    masses included as if on their shafts. Without, equations are the paper's: the weight of these
    masses in Eq. (3) comes on top of that of `mass_kg` in Eq. (2).
    """

    mass_kg: Annotated[Positive, Quantity("kg", "Table I", "mini-robot mass")] = 0.1
    masses_included: Annotated[
        bool, Quantity("", "Eq. (2) and (3)", "whether mass_kg includes the eccentric masses")
    ] = False
    diameter_m: Annotated[Positive, Quantity("m", "Table I", "mini-robot diameter")] = 0.05
    height_m: Annotated[Positive, Quantity("m", "Table I", "mini-robot height")] = 0.045
    motor_diameter_m: Annotated[
        Amount, Quantity("m", "Table I", "vibration motor body diameter")
    ] = 0.0044
    motor_length_m: Annotated[Amount, Quantity("m", "Table I", "vibration motor body length")] = (
        0.0102
    )
    com_height_m: Annotated[
        Positive,
        Quantity("m", "assumed: battery and motors sit low", "centre of mass above the floor"),
    ] = 0.015
    com_x_m: Annotated[
        float, Quantity("m", "assumed", "centre of mass before the robot's axis, without payload")
    ] = 0.0
    com_y_m: Annotated[
        float, Quantity("m", "assumed", "centre of mass to the left of it, likewise")
    ] = 0.0
    mu: Annotated[
        Amount,
        Quantity("1", "assumed: 0.1 to 0.4 in the literature", "Coulomb friction of the feet"),
    ] = 0.15
    mu_robots: Annotated[
        Amount, Quantity("1", "assumed, on any floor", "Coulomb friction between robots that touch")
    ] = 0.15
    inertia_kg_m2: Annotated[
        tuple[Positive, ...],
        Quantity("kg.m2", "computed: uniform cylinder", "moments about the centre of mass, if any"),
    ] = ()
    motors: Annotated[
        tuple[Mount, ...],
        Meta(min_length=1),
        Quantity("m", "Table I: height; assumed: just inside the rim", "motors D, E and so on"),
    ] = (
        Mount((0.0, 0.0225, 0.003), (0.0, 1.0, 0.0)),
        Mount((0.0, -0.0225, 0.003), (0.0, -1.0, 0.0)),
    )
    feet: Annotated[
        tuple[Foot, ...],
        Meta(min_length=1),
        Quantity("m", "assumed: circle of 23 mm, just inside the rim", "feet A, B, C and so on"),
    ] = (
        Foot(0.011500000000000002, 0.019918584287042088),
        Foot(-0.023, 0.0),
        Foot(0.011500000000000002, -0.019918584287042088),
    )

    @property
    def elastic(self) -> bool:
        """Whether its feet are elastic legs."""
        return self.feet[0].leg is not None

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Numbers of motors, of feet and of elastic legs."""
        feet = len(self.feet)
        return len(self.motors), feet, feet if self.elastic else 0

    @property
    def foot_radius_m(self) -> float:
        """Largest distance of a foot from the robot's axis."""
        return max(math.sqrt(foot.x_m * foot.x_m + foot.y_m * foot.y_m) for foot in self.feet)

    def spread(self, factor: float) -> "RobotParams":
        """Return a robot whose motors and feet are a factor as far from its axis."""
        motors = (
            mount._replace(place_m=(factor * x, factor * y, z))
            for mount in self.motors
            for x, y, z in [mount.place_m]
        )
        feet = (foot._replace(x_m=factor * foot.x_m, y_m=factor * foot.y_m) for foot in self.feet)
        return self._replace(motors=tuple(motors), feet=tuple(feet))


class NoiseParams(NamedTuple):
    """White noise on each measured motor speed (Section V: ±5 % of the nominal speed).

    The nominal speed is the set point of Eq. (14): a motor that stands has no noise.
    """

    relative_amplitude: Annotated[
        Amount, Quantity("1", "Section V", "half width of the uniform noise over the set point")
    ] = 0.05
    hold_s: Annotated[
        Amount,
        Quantity("s", "assumed: the paper gives no band width", "time one noise value holds"),
    ] = 1e-3


class TimingParams(NamedTuple):
    """Clock of the co-simulation; every slower period is an integer multiple of `dt_s`."""

    dt_s: Annotated[Positive, Quantity("s", "Section V", "integration and communication step")] = (
        1e-5
    )
    communication_step_s: Annotated[
        Positive,
        Quantity("s", "assumed: every integration step", "time between exchanges with the FMUs"),
    ] = 1e-5
    control_period_s: Annotated[
        Positive, Quantity("s", "assumed: 1 kHz on-board controller", "steering period")
    ] = 1e-3
    rl_step_s: Annotated[Positive, Quantity("s", "Section V", "time between two decisions")] = 2.0
    move_limit_s: Annotated[
        Amount,
        Quantity("s", "assumed: several times a turn and a cell", "time after which a move ends"),
    ] = 40.0
    episode_limit_s: Annotated[
        Amount, Quantity("s", "assumed: none in the paper", "simulated time that ends an episode")
    ] = 600.0
    burst_s: Annotated[
        Amount, Quantity("s", "a recording's level", "start of an RL step sampled at every tick")
    ] = 0.0


class MotorShares(NamedTuple):
    """What a motor does in each motion primitive of its machine, as a share of the speed of it."""

    # forwards, backwards, leftwards, rightwards: of the speeds of driving
    forwards: Share = 0.0
    backwards: Share = 0.0
    leftwards: Share = 0.0
    rightwards: Share = 0.0
    # left_turn, right_turn: of the speed of turning
    left_turn: Share = 0.0
    right_turn: Share = 0.0
    # dither, turn_dither: of the dither, while driving and while turning
    dither: Share = 0.0
    turn_dither: Share = 0.0


# Motors D and E of Fig. 4b, by the signs of Eq. (3); they drive no robot sideways.
PAIR = (
    MotorShares(-1.0, 1.0, 0.0, 0.0, 1.0, -1.0, 1.0, -1.0),
    MotorShares(1.0, -1.0, 0.0, 0.0, 1.0, -1.0, 1.0, 1.0),
)


Facings = Literal[2, 4, 8]


class Drive(NamedTuple):
    """What a machine does in one of its drives, and what turns it meanwhile."""

    speed: float = 1.0  # as a share of `drive_speed_m_s`
    yaw_gain: float = 1.0  # of the difference, as a share of that of the steering
    # Share of each motor in the difference that turns the driving robot counter-clockwise
    difference: tuple[float, ...] = (1.0, 1.0)


class SteeringParams(NamedTuple):
    """Heading and line control that turn a commanded direction into motor set points.

    The motor speeds realise the desired ones: `cosim.calibration.measuring` finds them for
    the parameters at hand, the values here are its result for the defaults. See docs/steering.md.
    """

    drive_speed_m_s: Annotated[
        Amount,
        Quantity(
            "m/s", "assumed: a diagonal move in 4 s, no hop up to μ = 0.2", "desired velocity"
        ),
    ] = 0.0039
    turn_rate_rad_s: Annotated[
        Amount,
        Quantity("rad/s", "assumed: no hop up to μ = 0.2", "desired yaw rate on the spot, at most"),
    ] = 0.2
    forward_speed_rad_s: Annotated[
        Amount,
        Quantity("rad/s", "calibrated: drive_speed_m_s", "motor speed while driving forwards"),
    ] = 992.1
    backward_speed_rad_s: Annotated[
        Amount,
        Quantity("rad/s", "calibrated: drive_speed_m_s", "motor speed while driving backwards"),
    ] = 1023.5
    turn_speed_rad_s: Annotated[
        Amount, Quantity("rad/s", "calibrated: turn_rate_rad_s", "motor speed while turning")
    ] = 1015.4
    turn_radius_m: Annotated[
        Amount, Quantity("m", "on the spot", "radius of the circle in which the robot turns")
    ] = 0.0
    max_speed_rad_s: Annotated[
        Amount, Quantity("rad/s", "calibrated: no hop", "bound on motor speeds while driving")
    ] = 1082.6
    dither_rad_s: Annotated[
        Amount,
        Quantity("rad/s", "assumed", "alternating speed difference that averages motor phases"),
    ] = 20.0
    turned_rad: Annotated[
        Amount, Quantity("rad", "assumed", "heading error below which turning ends")
    ] = 0.15
    turn_again_rad: Annotated[
        Amount, Quantity("rad", "assumed", "heading error above which driving becomes turning")
    ] = 0.35
    heading_gain_1_s: Annotated[
        Amount, Quantity("1/s", "assumed", "speed difference of the motors per heading error")
    ] = 4000.0
    max_difference_rad_s: Annotated[
        Amount, Quantity("rad/s", "assumed: half of it is free of loss", "bound on that difference")
    ] = 100.0
    yaw_gain: Annotated[
        Amount, Quantity("1", "calibration: 0.05 rad/s at 100 rad/s", "yaw rate of that difference")
    ] = 5e-4
    lookahead_m: Annotated[
        Positive,
        Quantity("m", "assumed: one cell", "distance over which a lateral error is closed"),
    ] = 0.01
    least_lookahead_m: Annotated[
        Positive, Quantity("m", "assumed", "the same close to the end of the line")
    ] = 0.004
    side_speed_rad_s: Annotated[
        Amount, Quantity("rad/s", "calibrated", "motor speed while driving sideways; 0: never")
    ] = 0.0
    pulse_s: Annotated[
        Amount, Quantity("s", "the motors run without pause", "time that one motor runs in turn")
    ] = 0.0
    pause_s: Annotated[Amount, Quantity("s", "no pause", "time between two of these pulses")] = 0.0
    shares: Annotated[
        tuple[MotorShares, ...],
        Quantity("1", "Eq. (3)", "shares of these speeds of each motor, by motion primitive"),
    ] = PAIR
    drives: Annotated[
        tuple[Drive, Drive, Drive, Drive],
        Quantity("1", "Eq. (3)", "driving forwards, backwards, leftwards and rightwards"),
    ] = (Drive(), Drive(), Drive(), Drive())

    @property
    def given(self) -> bool:
        """Whether the motors' shares are there: given by the machine's file, or found."""
        return any(any(own) for own in self.shares)

    @property
    def facings(self) -> Facings:
        """Number of headings, evenly spread, that need different turns before a drive.

        All 8 of a machine that only drives forwards; 4 axes if it drives backwards, too; and 2 if
        it also drives sideways.
        """
        if self.backward_speed_rad_s <= 0.0:
            return 8
        return 2 if self.side_speed_rad_s > 0.0 else 4


class EstimatorParams(NamedTuple):
    """Assumptions of a robot's filter about its motion; see `cosim.onboard.estimation`."""

    position_drift_m2_s: Annotated[
        Amount,
        Quantity("m2/s", "assumed: 0.6 mm in 1 s", "growth of the variance of a driven position"),
    ] = 3.6e-7
    heading_drift_rad2_s: Annotated[
        Amount,
        Quantity("rad2/s", "assumed: 1.7° in 1 s", "growth of the variance of a driven heading"),
    ] = 9e-4
    settle_s: Annotated[
        Amount,
        Quantity("s", "measured: at rest after 0.03 s", "time after a stop that counts as driven"),
    ] = 0.1


class ShieldParams(NamedTuple):
    """Distances that the shield keeps, see `cosim.onboard.shield` and docs/shield.md."""

    stopping_m: Annotated[
        Amount,
        Quantity("m", "measured: 1 stop in 1e5, and 1/4", "from a look at a robot until it rests"),
    ] = 1.1e-4
    room_m: Annotated[
        Amount, Quantity("m", "assumed: several retreats that fail", "room below which robots stop")
    ] = 6e-4
    loss_m: Annotated[
        Amount, Quantity("m", "assumed: more than the vibration", "room that a retreat may cost")
    ] = 1e-4
    stray_m: Annotated[
        Amount,
        Quantity("m", "benchmarks steering: driving", "gap of plans beyond that of stopping"),
    ] = 1e-3
    retreat_m: Annotated[Amount, Quantity("m", "assumed: one cell", "length of a retreat")] = 0.01
    deviations: Annotated[
        Amount,
        Quantity("1", "measured with a camera: 5 and the bias", "bound on an estimate's error, σ"),
    ] = 5.0
    jitter: Annotated[
        Amount, Quantity("1", "assumed", "standard deviations that room_m and loss_m grow by")
    ] = 1.5


class Fig3Params(NamedTuple):
    """1-DOF platform that gives the motion printed in Fig. 3; the paper states none of these."""

    M: float = 0.1  # kg, Table I: platform mass
    m: float = 0.002  # kg, eccentric mass; assumed: its weight keeps the platform on the floor
    r: float = 0.0109  # m, eccentricity; assumed: 9.9 m/s² on the platform at that speed
    mu: float = 0.5  # Coulomb friction; assumed: read off Fig. 3
    omega: float = 213.0  # rad/s, motor speed; assumed: read off Fig. 3, 29.5 ms per turn


class Fig7Params(NamedTuple):
    """Operating point of Fig. 7 (open- and closed-loop response of one motor)."""

    omega_des: float = 700.0  # rad/s, Table II: desired rotational speed
    d: float = 1e-6  # N m, Table II: disturbance torque
    open_loop_V: float = 0.709  # V, open-loop voltage; assumed: gives 700 rad/s without d


TABLE_II = MotorParams()
TABLE_I = RobotParams()
SPEED_NOISE = NoiseParams()
TIMING = TimingParams()
STEERING = SteeringParams()
ESTIMATOR = EstimatorParams()
SHIELD = ShieldParams()
FIG_3 = Fig3Params()
FIG_7 = Fig7Params()


def describe(record: Any) -> dict[str, tuple[Any, Quantity]]:
    """Value and `Quantity` of every field of a record that has one, in declaration order."""
    return {
        name: (getattr(record, name), annotation)
        for name, hint in get_type_hints(type(record), include_extras=True).items()
        for annotation in getattr(hint, "__metadata__", ())
        if isinstance(annotation, Quantity)
    }


def motor_names(motors: int) -> str:
    """Return a letter for each motor of a robot, from D on as in the paper."""
    return "DEFGHIJK"[:motors]


def feet_names(feet: int) -> tuple[str, ...]:
    """Return a name for each foot of a robot: A, B and C as in the paper, else F1 and so on."""
    return ("A", "B", "C") if feet == 3 else tuple(f"F{foot + 1}" for foot in range(feet))


def level_share(axis: Place) -> float:
    """Share of gravity that turns a mass about a shaft: the sine of its angle to the vertical."""
    return math.sqrt(axis[0] * axis[0] + axis[1] * axis[1])


def motors_of(robot: RobotParams, motor: MotorParams) -> tuple[MotorParams, ...]:
    """Parameters of each motor of a robot."""
    return tuple(motor._replace(**dict(mount.own)) for mount in robot.motors)


def cylinder_inertia(robot: RobotParams) -> tuple[float, float, float]:
    """Moments (Ixx, Iyy, Izz) in kg m²: those stated, else of a uniform cylinder by Table I."""
    if robot.inertia_kg_m2:
        i_xx, i_yy, i_zz = robot.inertia_kg_m2
        return i_xx, i_yy, i_zz
    radius = robot.diameter_m / 2.0
    i_zz = robot.mass_kg * radius**2 / 2.0
    i_xx = robot.mass_kg * (3.0 * radius**2 + robot.height_m**2) / 12.0
    return i_xx, i_xx, i_zz


def motor_gain(motor: MotorParams) -> float:
    """DC gain K = K_T/(bR + K_T²) of Eq. (13) without Coulomb friction, in rad/s per V."""
    return motor.K_T / (motor.b * motor.R + motor.K_T**2)


def open_loop_voltage(motor: MotorParams) -> tuple[float, float]:
    """Voltage that keeps a speed in the mean (Eq. 13): V per rad/s, and V against Coulomb friction.

    The torque of the eccentric mass's weight is left out: it averages to zero over a turn.
    """
    return 1.0 / motor_gain(motor), motor.c * motor.R / motor.K_T


def voltage_speed(motor: MotorParams) -> float:
    """Return the speed in rad/s that the largest voltage keeps in the mean."""
    per_speed, friction = open_loop_voltage(motor)
    return max(0.0, motor.V_s_max - friction) / per_speed


def motor_time_constant(motor: MotorParams) -> float:
    """Time constant τ = JR/(bR + K_T²) of Eq. (13) without Coulomb friction, in s."""
    return motor.J * motor.R / (motor.b * motor.R + motor.K_T**2)


def lift_off_speed(robot: RobotParams, motor: MotorParams) -> float:
    """Motor speed in rad/s at which all motors in phase lift the robot: Σ m r ω² is its weight.

    Vertical shafts lift nothing: then the largest speed that a motor has at its largest voltage.
    """
    motors = list(zip(robot.motors, motors_of(robot, motor), strict=True))
    on_top = 0.0 if robot.masses_included else sum(own.m for _, own in motors)
    weight = (robot.mass_kg + on_top) * motor.g
    lifting = sum(own.m * own.r * level_share(mount.axis) for mount, own in motors)
    if lifting > 0.0:
        return math.sqrt(weight / lifting)
    return max(voltage_speed(own) for _, own in motors)

"""Options of the physics, declared once: fields of commands and arguments of `cosim.simulate`."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

import tyro

from cosim.base.arguments import ConfigError, require_names, validate_fields, validate_unique
from cosim.base.command import MACHINES, Count, MotorFmuFile, MotorParameters, Seed
from cosim.base.progress import Progress, silent, under_way
from cosim.model.config import (
    GIVEN,
    OF_MOTOR,
    CoSimConfig,
    Leaf,
    Loop,
    OnCollision,
    whole_ratio,
)
from cosim.model.params import SHIELD, STEERING, Amount, MotorParams, Positive
from cosim.model.preset import OF_LOOP, PAPER, SHOWN, Preset, find_preset
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_in_world
from cosim.model.world import IDEAL, Tree, World, tree_of

AnyWorld = str | Path | World | Mapping[str, Any] | None  # as a user gives one


@dataclass(frozen=True, kw_only=True)
class Physics:
    """Robots, motors and clock: what a calibration depends on."""

    preset: Annotated[
        str,
        tyro.conf.arg(
            metavar="NAME|FILE",
            help=f"Machine: {MACHINES}. What a world says overrides what the machine brings along, "
            "and --mu and --noise override both. Robots have the machine's diameter, which no "
            "scenario may contradict.",
        ),
    ] = PAPER
    mu: Amount | None = None
    """Coulomb friction coefficient of the feet on the floor (0.1 to 0.4 in the literature), 0.15 by
    default or as the preset says. Robots that touch each other have mu_robots of the preset."""
    noise: Amount | None = None
    """Half width of the uniform noise on measured motor speeds, relative to the set point; 0.05
    by default."""
    dt: Annotated[Positive | None, tyro.conf.arg(metavar="S")] = None
    """Integration step of the bodies in s; by default 1e-5 (Section V)."""
    communication_step: Annotated[Positive | None, tyro.conf.arg(metavar="S")] = None
    """Time between exchanges with the FMUs in s, a whole multiple of dt; by default dt."""
    reaction: bool = False
    """Let the motors feel the acceleration of the body, which the paper neglects."""
    motor_fmu: MotorFmuFile = None
    motor_parameters: MotorParameters = ()

    def __post_init__(self) -> None:
        validate_fields(self, but=["preset"] if isinstance(self.preset, Preset) else [])

    def tree(self) -> Tree:
        """Return the values that these options give, by their parameters' names."""
        motors = validate_unique("motor_parameters", self.motor_parameters)
        known = {name: value for name, value in motors.items() if name in MotorParams._fields}
        return tree_of(OF_MOTOR, **known, motor_parameters=tuple(motors.items()) or None) | tree_of(
            GIVEN,
            mu=self.mu,
            relative_amplitude=self.noise,
            dt_s=self.dt,
            communication_step_s=self.communication_step or self.dt,
            reaction=self.reaction or None,
        )

    def config(self, world: World = IDEAL, source: str = "world") -> CoSimConfig:
        """Return parameters for robots of the preset's size in a world, not yet calibrated.

        A parameter has the value of its option, else that of the world, which has `source`, else
        that of the machine, else the default.
        """
        for option, field in {"mu": "mu", "noise": "motor_speed_noise"}.items():
            if getattr(self, option) is not None and getattr(world, field) is not None:
                raise ConfigError(
                    f"--{option} is given in addition to the world's {field}; leave one of them out"
                )
        if self.motor_parameters:
            from cosim.fmi.motor import INPUTS, OPEN_INPUTS  # noqa: PLC0415 - with fmpy

            if inputs := dict(self.motor_parameters).keys() & {*INPUTS, *OPEN_INPUTS}:
                raise ConfigError(
                    f"motor_parameters names {min(inputs)}, which is set in every control period; "
                    "name a parameter"
                )
        return find_preset(self.preset).config(world.tree(source), self.tree())

    @property
    def machine(self) -> "Physics":
        """Return the machine and its motors alone: what moves are observed of."""
        own = {name: getattr(self, name) for name in ("preset", "motor_fmu", "motor_parameters")}
        return Physics(**own)

    def board(
        self, scenario: str | Path | Scenario, world: AnyWorld = None
    ) -> tuple[Scenario, World]:
        """Return a scenario with robots of the machine's size and the obstacles of its world.

        Args:
            scenario: name, file or record.
            world: file, record, or dict of its fields; by default that of the scenario file, else
                the paper's.

        Returns:
            It, and its world.
        """
        board, world = find_in_world(scenario, world)
        return find_preset(self.preset).board(board), world

    def fmu(self, progress: Progress = silent) -> Path:
        """The motor FMU: the one named, or the built-in one, which is compiled the first time."""
        # here, because commands parse their options before they load fmpy
        from fmus.build import cached_fmu  # noqa: PLC0415

        with under_way(progress, "preparing the motor FMU"):
            return (self.motor_fmu or cached_fmu()).absolute()

    def prepare(
        self,
        diameter_m: float | None = None,
        progress: Progress = silent,
        world: World = IDEAL,
        source: str = "world",
        *,
        calibrate: bool = True,
    ) -> tuple[CoSimConfig, Path]:
        """Parameters for robots in a world, see `config`, and the motor FMU.

        The built-in FMU is compiled the first time, a calibration measured (some seconds each).
        Episodes of a scenario are prepared by `resolve`, which describes `calibrate`.
        """
        config = self.config(world, source)
        if diameter_m is not None:
            config = config.sized(diameter_m)
        fmu = self.fmu(progress)
        if calibrate:
            return self._calibrated(config, fmu, progress), fmu
        from cosim.fmi.motor import with_motor  # noqa: PLC0415 - as above

        return with_motor(config, fmu).commanded, fmu

    def _calibrated(self, config: CoSimConfig, fmu: Path, progress: Progress) -> CoSimConfig:
        from cosim.calibration.measuring import calibrated  # noqa: PLC0415 - as above

        return calibrated(config, fmu, progress)


PROMPT_RL_STEP_S = 0.1  # assumed: robots asked so often drive on by less than 0.4 mm


@dataclass(frozen=True, kw_only=True)
class DecisionOptions:
    """Options for the times of decisions, and whether robots stop for them."""

    rl_step: Annotated[Positive | None, tyro.conf.arg(metavar="S")] = None
    """Time between two decisions in s: by default the paper's 2, and 0.1 with --through."""
    through: bool = False
    """Let robots drive through the centre of a cell without stopping where the next direction is
    the same, asked when their move ends (within 0.1 s) instead of every 2 s. The methods fastest
    (of two robots) and planned use such moves."""

    def tree(self) -> Tree:
        """Return the values that these options give, by their parameters' names."""
        prompt_s = PROMPT_RL_STEP_S if self.through and self.rl_step is None else None
        own = tree_of(GIVEN, through=self.through or None, rl_step_s=self.rl_step)
        return own | tree_of("set by --through", rl_step_s=prompt_s)


@dataclass(frozen=True, kw_only=True)
class SimulationOptions(Physics, DecisionOptions):
    """Robots, motors and clock, and how the robots drive with them."""

    world: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """World of the episodes (.toml with a table [world], see docs/scenarios.md): friction, motors,
    floor, load, obstacles, and the camera that robots are seen by; by default the paper's, or that
    of the scenario file."""
    speed: Annotated[Positive | None, tyro.conf.arg(metavar="MM_S")] = None
    """Speed while driving, in mm/s. Motor speeds follow from a calibration, which refuses a speed
    that needs hopping; by default 3.9, or what is possible without (0.97 with a μ of 0.4), and of
    machines whose primitives are found that at which they are."""
    on_collision: OnCollision = "end"
    """What happens when a robot touches another one or an obstacle, or its centre enters another
    one's target cell: the episode ends, or they push each other on."""
    shield: bool = False
    """Keep robots apart, off obstacles and on the board for any policy: a monitor in the control
    loop stops a robot in time and lets it retreat (docs/shield.md has its premises). How far robots
    go until they rest, and how well a camera locates them, is measured once for every world."""
    open_loop: tuple[Loop, ...] = ()
    """What goes without feedback: motors, which then get a constant voltage for every set point
    instead of the loop of Eq. (14), and heading, the course that robots keep while they drive."""
    time_limit: Annotated[Positive | None, tyro.conf.arg(metavar="S")] = None
    """Simulated time in s after which an episode ends as a time-out, a whole multiple of the RL
    step; by default 600, and longer in proportion where robots are slower than by default."""

    def tree(self) -> Tree:
        """See `Physics.tree`."""
        return (
            Physics.tree(self)
            | DecisionOptions.tree(self)
            | tree_of(
                GIVEN,
                episode_limit_s=self.time_limit,
                drive_speed_m_s=None if self.speed is None else 1e-3 * self.speed,
                on_collision=None if self.on_collision == "end" else self.on_collision,
                shield=SHIELD if self.shield else None,
                open_loop=self.open_loop or None,
            )
        )

    def config(self, world: World = IDEAL, source: str = "world") -> CoSimConfig:
        """See `Physics.config`."""
        if "motors" in self.open_loop:
            given = self.tree() | world.tree()
            for name in OF_LOOP:
                if name in given:
                    raise ConfigError(
                        f"{SHOWN.get(name, name)} has no effect with --open-loop motors, which "
                        "have no speed loop; leave it out"
                    )
        config = super().config(world, source)
        if self.time_limit is not None:  # else episodes would end at the end of an RL step
            whole_ratio("time_limit", self.time_limit, "rl_step_s", config.timing.rl_step_s)
        return config

    def _calibrated(self, config: CoSimConfig, fmu: Path, progress: Progress) -> CoSimConfig:
        """Limit the speed to the largest one without hopping, unless it is given."""
        from cosim.calibration.measuring import calibrated  # noqa: PLC0415 - as above
        from cosim.calibration.shielding import with_stopping_distance  # noqa: PLC0415

        slower = self.speed is None
        config = calibrated(config, fmu, progress, slower=slower)
        longer = STEERING.drive_speed_m_s / config.steering.drive_speed_m_s
        if slower and self.time_limit is None and longer > 1.0:
            limit_s = math.ceil(longer * config.timing.episode_limit_s)
            source = "computed: longer in proportion where robots are slower"
            config = config.having(source, episode_limit_s=limit_s)
        return with_stopping_distance(config, fmu, progress) if config.shield else config


@dataclass(frozen=True, kw_only=True)
class EpisodeOptions(SimulationOptions):
    """Robots, motors and clock, how the robots drive with them, and what is recorded."""

    seed: Seed = 0
    record: Literal["none", "summary", "default", "full"] = "default"
    """Amount to record: nothing (only summary.json and the policy are written); decisions and
    poses; every signal, motors at 200 Hz, under 8 MB per minute of two robots; or every signal at 1
    kHz with more and longer bursts at every tick."""
    signals: tuple[Count, ...] = ()
    """Robots with recorded signals, from 1; by default all of up to 64, else the first four. For
    the others only poses are recorded."""
    driver: Literal["fmpy", "compiled", "reference"] | None = None
    """Driver that steps the motor FMUs: fmpy calls doStep of fmpy's class once per control period
    of 1 ms; compiled calls their C functions at every tick (the same bits, somewhat faster);
    reference calls fmpy's class at every tick (the same bits, hundreds of times slower).
    By default fmpy, and compiled with --reaction or a motor FMU without samples of its outputs."""


Options = TypeVar("Options", bound=SimulationOptions)


def options_of(
    call: str, given: Mapping[str, Any], *more: str, kind: type[Options] = SimulationOptions
) -> Options:
    """Return the options that a call in Python is given by name."""
    known = [*more, *(option.name for option in fields(kind))]
    require_names(f"{call}: option ", given, known)
    return kind(**given)


class Setup(NamedTuple):
    """Everything that determines an episode, except for its policy, start cells and seed.

    The scenario has the obstacles of its world.
    """

    scenario: Scenario
    config: CoSimConfig
    fmu: Path


def resolve(
    options: SimulationOptions,
    scenario: str | Path | Scenario,
    progress: Progress = silent,
    *,
    world: AnyWorld = None,
    require: Callable[[Scenario], object] | None = None,
    calibrate: bool = True,
) -> Setup:
    """Return the setup of a scenario under options.

    Args:
        world: see `Physics.board`; by default that of the options.
        require: refuses scenarios, for example those that a policy was not trained on, before
            anything is measured.
        calibrate: whether robots are given directions or velocities, which needs a machine that
            can be steered, or set points of their motors, see `CoSimConfig.commanded`.
    """
    scenario, world, source = _placed(options, scenario, world)
    if require is not None:
        require(scenario)
    prepared = options.prepare(scenario.diameter_m, progress, world, source, calibrate=calibrate)
    return Setup(scenario, *prepared)


def declared(
    options: SimulationOptions, scenario: str | Path | Scenario, progress: Progress = silent
) -> CoSimConfig:
    """Return the parameters of a scenario's episodes before anything is calibrated."""
    from cosim.fmi.motor import with_motor  # noqa: PLC0415 - with fmpy

    board, world, source = _placed(options, scenario, None)
    return with_motor(options.config(world, source).sized(board.diameter_m), options.fmu(progress))


def _placed(
    options: SimulationOptions, scenario: str | Path | Scenario, world: AnyWorld
) -> tuple[Scenario, World, str]:
    """Return a scenario's board, its world, and what parameters of that have as their source."""
    given = options.world if world is None else world
    board, found = options.board(scenario, given)
    name = Path(given).stem if isinstance(given, str | Path) else f"of scenario {board.name}"
    return (
        board,
        found,
        f"world {name}" if given is None or isinstance(given, str | Path) else "world",
    )


def differing(config: CoSimConfig) -> dict[str, Leaf]:
    """Return the parameters that are not the default, by name."""
    usual = CoSimConfig().leaves()
    return {
        name: leaf
        for name, leaf in config.leaves().items()
        if name not in usual or leaf.value != usual[name].value
    }

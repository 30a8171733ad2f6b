"""Options of the benchmarks, and those that lie in this folder; see `benchmarks.__main__`."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from cosim.base.command import Jobs, Json, MotorFmuFile, require_at_least
from cosim.base.errors import UserError
from cosim.model.params import TABLE_I

COUNTS = {
    "boards",
    "branches",
    "episodes",
    "exchanges",
    "machines",
    "phases",
    "repeats",
    "roots",
    "rounds",
    "scalar_starts",
    "seeds",
    "starts",
    "steps",
    "test_episodes",
    "unshielded",
}
Seconds = Annotated[float, tyro.conf.arg(metavar="S")]


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """Options of every benchmark."""

    json: Json = False

    def __post_init__(self) -> None:
        counts = {name: value for name, value in asdict(self).items() if name in COUNTS}
        require_at_least(1, **counts)


@dataclass(frozen=True, kw_only=True)
class Convergence(Benchmark):
    """Halve the time step, solve the contacts out, and see what changes.

    Mean forward speed and yaw rate at nine manoeuvres, for every time step with the usual
    contact sweeps, and for the middle one with contacts solved out.
    """

    dt: Annotated[tuple[float, ...], tyro.conf.arg(metavar="S")] = (2e-5, 1e-5, 5e-6)
    """Time steps in s, coarse to fine."""
    settle: Seconds = 0.5
    """Simulated time before the averages begin, in s."""
    duration: Seconds = 2.0
    """Simulated time of the averages, in s (whole turns of the motors)."""

    def __post_init__(self) -> None:
        if len(self.dt) < 2 or min(self.dt) <= 0.0:
            raise UserError("--dt: name two or more time steps above 0")


@dataclass(frozen=True, kw_only=True)
class CosimStep(Benchmark):
    """Measure what a co-simulated second costs and print ratios from one run."""

    rounds: int = 40
    """Rounds of every measurement; the best counts."""
    lanes: Literal[1, 2, 4, 8] | None = None
    """Bodies in a vector of the batch, by default as many as the processor has."""


@dataclass(frozen=True, kw_only=True)
class DriveMap(Benchmark):
    """Mean forward speed and yaw rate of one robot, driving and turning.

    For every motor speed: with both motors in phase, and the mean, least and greatest value over
    all phase differences.
    """

    omega: Annotated[tuple[float, ...], tyro.conf.arg(metavar="RAD_S")] = (
        700.0,
        800.0,
        900.0,
        1000.0,
        1100.0,
    )
    """Motor speeds in rad/s."""
    mu: float = TABLE_I.mu
    """Coulomb friction coefficient of the feet."""
    phases: int = 16
    """Phase differences, evenly spread over a turn."""
    duration: Seconds = 1.0
    """Simulated time of the averages in s, after half a second to settle."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.omega or min(self.omega) <= 0.0:
            raise UserError("--omega: name motor speeds above 0")


@dataclass(frozen=True, kw_only=True)
class Evaluation(Benchmark):
    """Evaluate a policy in the dynamics as cosim.evaluate does, and its episodes one by one."""

    scenario: str = "2"
    """Scenario; the policy is trained by the method paper, or found in the cache."""
    starts: int = 48
    """Episodes of the evaluation."""
    scalar_starts: int = 24
    """Those of them to be simulated one by one as well."""
    jobs: Jobs = 1


@dataclass(frozen=True, kw_only=True)
class FmuStep(Benchmark):
    """Time one exchange with the motor FMU by three drivers.

    Only the built-in FMU has an inlined twin with the same bits.
    """

    motor_fmu: MotorFmuFile = None
    exchanges: int = 20_000
    """Exchanges per round and compiled driver; fmpy makes a fiftieth of them."""
    rounds: int = 200
    """Rounds; the drivers take turns, and the fastest round of each counts: short and many, so that
    another process on the machine spoils some rounds and not the result."""


@dataclass(frozen=True, kw_only=True)
class Identification(Benchmark):
    """Identify machines that are known, from 60 s of what a camera sees of them.

    Errors and intervals of every parameter. What has been identified is kept in --out: the same
    command resumes.
    """

    machines: int = 40
    """Machines, drawn at random."""
    seed: int = 0
    """Of the machines, their speed noise and the camera's noise."""
    jobs: Jobs = -1
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/identification")
    """Folder of results."""


@dataclass(frozen=True, kw_only=True)
class Positioning(Benchmark):
    """Repeat single turns and short pulses of the motors: how far apart robots come to rest.

    With the steering's feedback, with speed control alone and without, from the same motor angles
    and from any, below and within the speeds at which robots move without hopping.
    """

    robots: int = 100
    """Repetitions, each with a noise of its own."""
    omega: Annotated[tuple[float, ...], tyro.conf.arg(metavar="RAD_S")] = (
        500.0,
        700.0,
        900.0,
        1050.0,
    )
    """Motor speeds in rad/s, below lift-off."""
    pulses: Annotated[tuple[float, ...], tyro.conf.arg(metavar="S")] = (0.02, 0.05, 0.2)
    """Lengths of the pulses in s."""
    angles: Annotated[tuple[float, ...], tyro.conf.arg(metavar="DEG")] = (45.0, 85.0)
    """Angles of the turns in degrees, below 90, beyond which robots drive backwards instead."""
    seed: int = 0
    """Seed of the noise and of the motor angles at the start."""


@dataclass(frozen=True, kw_only=True)
class Reaction(Benchmark):
    """Measure the size of the body's reaction on the motors."""

    steps: int = 5
    """RL steps of 2 s to drive."""


@dataclass(frozen=True, kw_only=True)
class Recording(Benchmark):
    """Measure the size, the cost and the opening time of every level of --record."""

    levels: tuple[Literal["summary", "default", "full"], ...] = ("summary", "default", "full")
    """Levels to measure."""
    rounds: int = 7
    """Rounds of each kind in the measurement of cost; the best counts."""
    round_s: Seconds = 60.0
    """Simulated time of a round in s."""
    episode_s: Seconds = 60.0
    """Simulated time of the episodes whose sizes and opening times are measured, in s."""
    viewer: bool = True
    """Whether to open recordings in the viewer; --no-viewer where there is no Vulkan."""


@dataclass(frozen=True, kw_only=True)
class Sensitivity(Benchmark):
    """Calibrate robots with other assumed parameters, one at a time, and see what changes.

    Speeds at the default motor speeds and at the largest ones without hopping, and the share of
    time in which a foot is off the floor.
    """

    jobs: Jobs = 2


@dataclass(frozen=True, kw_only=True)
class Steering(Benchmark):
    """Compare controllers: a straight line of 20 cm, and moves of one cell, over seeds.

    Robots have motors at rest, noise of ±5 % and unknown phases between the motors; half
    of them drive forwards, half backwards.
    """

    seeds: int = 20
    """Robots of every case; each has noise of its own."""
    mu: float = TABLE_I.mu
    """Coulomb friction coefficient of the feet."""
    controllers: tuple[str, ...] = ()
    """Controllers to compare, by default all."""
    motor_spread: float = 0.0
    """Relative standard deviation of K_T, R, J and m r of every motor."""

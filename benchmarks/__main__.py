"""`python -m benchmarks NAME`: what things cost, how they converge, and what helps.

A module can be run alone, too: `python -m benchmarks.steering`.

A benchmark is a module with `measure`, whose arguments are the options here, and `show`.
"""

import sys
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args

import tyro

from cosim.base.command import Jobs, Json, MotorFmuFile, print_json
from cosim.base.config import whole_ratio
from cosim.base.errors import UserError, run_command
from cosim.base.params import TABLE_I, TIMING
from cosim.base.progress import progress_bars, under_way

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
    "unshielded",
}
Adversary = Literal["short", "random", "greedy", "learnt"]
Seconds = Annotated[float, tyro.conf.arg(metavar="S")]


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """Options of every benchmark."""

    json: Json = False

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if name in COUNTS and value < 1:
                raise UserError(f"--{name.replace('_', '-')} must be at least 1")


@dataclass(frozen=True, kw_only=True)
class Adversaries(Benchmark):
    """Let policies that want robots to collide loose on the shield, and on robots without it.

    What has been simulated is kept in --out: the same command goes on.
    """

    episodes: int = 2000
    """Episodes with the shield, of four kinds of adversaries in turn, 250 each."""
    unshielded: int = 1000
    """Episodes without it."""
    kinds: tuple[Adversary, ...] = get_args(Adversary)
    """Adversaries to let loose, all by default; the episodes of others are left out."""
    robots: Literal[2, 3] = 2
    """Robots on the board."""
    world: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """World of the episodes (.toml with a table [world]), by default the paper's."""
    jobs: Jobs = -1
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/adversaries")
    """Folder of results."""


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
class Endurance(Benchmark):
    """Simulate hours of two robots, without and with a recording: memory, cost and what drifts."""

    hours: Annotated[float, tyro.conf.arg(metavar="H")] = 1.0
    """Simulated time of each of the two runs, in hours; at least two minutes."""
    seed: int = 0
    """Of the episodes."""

    def __post_init__(self) -> None:
        if not 2 / 60 <= self.hours < 1e4:
            raise UserError("--hours must be 0.034 (two minutes) to 10000")
        if self.seed < 0:
            raise UserError("--seed must not be negative")


@dataclass(frozen=True, kw_only=True)
class Envs(Benchmark):
    """Time the environments of many boards on the grid, and PettingZoo's of one.

    With the same random actions, on one core.
    """

    scenario: str = "2"
    """Scenario, of any number of robots."""
    boards: int = 4096
    """Boards that are stepped together."""
    repeats: int = 10
    """Rounds of both, in turn; the best of each counts."""


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
class Falsification(Benchmark):
    """Count the episodes that searches need to find the first collision of a policy.

    By a surrogate, by evolution and at random, in the same ranges and with the same seeds. Episodes
    are kept in --out: the same command goes on.
    """

    scenario: str = "4"
    """Scenario of two robots or more."""
    method: str = "shortest"
    """By which the policy is made, see `python -m cosim.run --help`; one that collides rarely."""
    shield: bool = False
    """Whether robots have the shield (docs/shield.md)."""
    ranges: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Ranges to search, as of `minirobots falsify`."""
    seeds: int = 3
    """Searches of each kind."""
    episodes: int = 200
    """Episodes of a search that finds nothing."""
    jobs: Jobs = -1
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/falsification")
    """Folder of results and recordings."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.episodes < 1:
            raise UserError("--episodes must be at least 1")


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
    command goes on.
    """

    machines: int = 40
    """Machines, drawn at random."""
    seed: int = 0
    """Of the machines, their speed noise and the camera's noise."""
    jobs: Jobs = -1
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/identification")
    """Folder of results."""


@dataclass(frozen=True, kw_only=True)
class MovesLearning(Benchmark):
    """Train on observed moves with several variants and play the greedy policies on them."""

    episodes: int = 1_500_000
    """Training episodes of each variant."""
    test_episodes: int = 50_000
    """Greedy episodes of each variant."""
    scenario: str = "4"
    """Scenario of two robots or more."""
    variants: tuple[str, ...] = ()
    """Variants to train, by default all."""


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
class ReferenceFmus(Benchmark):
    """Run the reference FMUs of the Modelica Association to the outputs that they publish."""

    src: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Copy of https://github.com/modelica/Reference-FMUs."""


@dataclass(frozen=True, kw_only=True)
class Sensitivity(Benchmark):
    """Calibrate robots with other assumed parameters, one at a time, and see what changes.

    Speeds at the default motor speeds and at the largest ones without hopping, and the share of
    time in which a foot is off the floor.
    """

    jobs: Jobs = 2


@dataclass(frozen=True, kw_only=True)
class Splitting(Benchmark):
    """Hold how often robots come close and collide, by splitting, against plain episodes.

    Of the paper's policy, without the shield. What has been simulated is kept in --out: the same
    command goes on.
    """

    scenario: str = "4"
    """Scenario of two robots or more."""
    episodes: int = 100
    """Plain episodes."""
    roots: int = 40
    """Independent episodes that are split."""
    branches: int = 4
    """Branches that an episode has after a level."""
    gaps: tuple[float, ...] = (10.0, 3.0)
    """Levels: gaps between the robots in mm."""
    seed: int = 0
    """Of the plain episodes; the roots have the next one."""
    jobs: Jobs = -1
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/splitting")
    """Folder of results."""


@dataclass(frozen=True, kw_only=True)
class Ssp(Benchmark):
    """Hold masters not written here on the SSP archives of two robots against ours.

    Each drives the pair with constant motor set points on an open floor.
    """

    step: Seconds = 1e-4
    """Communication step in s: 1e-3 s is a whole number of them."""
    duration: Seconds = 1.0
    """Simulated time in s."""

    def __post_init__(self) -> None:
        whole_ratio("--step", self.step, "the internal step", TIMING.dt_s)
        whole_ratio("1e-3 s", 1e-3, "--step", self.step)
        whole_ratio("--duration", self.duration, "1e-3 s", 1e-3)


@dataclass(frozen=True, kw_only=True)
class Steering(Benchmark):
    """Compare controllers: a straight line of 20 cm, and moves of one cell, over seeds.

    Robots have motors at rest, noise of ±5 % and phases between the motors that nobody knows; half
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


@dataclass(frozen=True, kw_only=True)
class System(Benchmark):
    """Couple two oscillators by each algorithm, and time a step beside a loop through fmpy."""

    rounds: int = 20
    """Rounds of the measurement of time; the best counts."""


@dataclass(frozen=True, kw_only=True)
class Training(Benchmark):
    """Time the training of scenario 4 over Section V's 5 000 000 episodes."""

    repeats: int = 3
    """Timed trainings of each kind; the fastest counts."""
    all: bool = False
    """Also time 20 runs of each of the five scenarios on all cores (a few minutes)."""


MODULES: dict[type[Benchmark], str] = {
    Adversaries: "reliability.adversaries",
    Convergence: "convergence",
    CosimStep: "cosim_step",
    DriveMap: "drive_map",
    Endurance: "reliability.endurance",
    Envs: "learning.envs",
    Evaluation: "evaluation",
    Falsification: "reliability.falsification",
    FmuStep: "fmu_step",
    Identification: "identification",
    MovesLearning: "learning.moves_learning",
    Reaction: "reaction",
    Recording: "recording",
    ReferenceFmus: "coupled.reference_fmus",
    Sensitivity: "sensitivity",
    Splitting: "reliability.splitting",
    Ssp: "masters.ssp",
    Steering: "steering",
    System: "coupled.system",
    Training: "learning.training",
}


def main() -> None:
    """Command line; see the classes above."""
    choice: Any = Union[tuple(MODULES)]  # noqa: UP007 - of types that are listed above
    config = (tyro.conf.FlagCreatePairsOff,)
    options: Benchmark = tyro.cli(choice, prog="python -m benchmarks", config=config)
    arguments = asdict(options)
    as_json = arguments.pop("json")
    name = MODULES[type(options)]
    module = import_module(f"benchmarks.{name}")
    with progress_bars() as progress, under_way(progress, f"benchmark {name.rpartition('.')[2]}"):
        found = module.measure(**arguments)
    module.show(found)
    if as_json:
        print_json(found)


def run_alone(file: str) -> None:
    """Run the benchmark of a module's file."""
    sys.argv.insert(1, Path(file).stem.replace("_", "-"))
    run_command(main)


if __name__ == "__main__":
    run_command(main)

"""Ranges of a search, and the episode of a vector in them.

A vector has a coordinate for the start of every robot, for the initial phase of every motor, for
the seed of the noise, and for everything of the world that has a range. Coordinates are any real
numbers: they are folded into 0 to 1, so that neighbours stay neighbours at the ends.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from cosim.base.errors import UserError
from cosim.base.reading import Kind, read_toml
from cosim.coupling.assembly import MOTOR_NAMES
from cosim.model.config import CoSimConfig
from cosim.model.scenario import Cell, Scenario
from cosim.model.world import Sensor, World

START, PHASE, SEED = "start", "motor_phase_deg", "seed"
OF_SENSOR = tuple(f"sensor.{name}" for name in Sensor.__struct_fields__)
OF_WORLD = (
    "mu",
    "motor_spread",
    "motor_speed_noise",
    "restitution",
    "floor_tilt_deg",
    "payload_g",
    *OF_SENSOR,
)
NAMES = (START, PHASE, SEED, *OF_WORLD)

# First standard deviations of a search: it keeps near bad starts; of the rest little is known.
_STEPS, _STEP = {START: 0.08}, 0.3

Range = tuple[float, float]  # equal ends: a value that is not searched
# Share of a robot's start cells, all angles of all motors, a thousand seeds.
DEFAULT: dict[str, Range] = {START: (0.0, 1.0), PHASE: (-180.0, 180.0), SEED: (0.0, 999.0)}


class RangeError(UserError):
    """Invalid ranges. The message names the range and how to fix it."""


_FILE = Kind("file of ranges", "check the path given by --ranges", RangeError)


class ChosenEpisode(NamedTuple):
    """An episode to simulate.

    Attributes:
        starts: start cell of each robot.
        seed: of the speed noise and of what the world draws.
        world: as declared, with initial phases of the motors.
    """

    starts: tuple[Cell, ...]
    seed: int
    world: World


def read_ranges(path: Path) -> dict[str, Range]:
    """The ranges of a TOML file: the table `[ranges]`, those of the camera in `[ranges.sensor]`.

    Raises:
        RangeError: the file is missing, no TOML, or has something else.
    """
    content = read_toml(path, _FILE)
    table = content.pop("ranges", None)
    if content or not isinstance(table, dict):
        raise RangeError(f"{path}: a table [ranges] and nothing else is expected; see --help")
    sensor = table.pop("sensor", {})
    if not isinstance(sensor, dict):
        raise RangeError(f"{path}: ranges.sensor is not a table; write [ranges.sensor]")
    named = table | {f"sensor.{name}": value for name, value in sensor.items()}
    return {name: _range(f"{path}: ranges.{name}", name, value) for name, value in named.items()}


def ranges_of(given: str | Path | Mapping[str, Any]) -> dict[str, Range]:
    """Return ranges by name, or those of a file.

    Raises:
        RangeError: see `read_ranges`.
    """
    if isinstance(given, Mapping):
        return {name: _range(f"ranges[{name!r}]", name, value) for name, value in given.items()}
    return read_ranges(Path(given))


def _range(where: str, name: str, value: Any) -> Range:
    if name not in NAMES:
        raise RangeError(f"{where} is unknown; choose from {', '.join(NAMES)}")
    try:
        low, high = msgspec.convert(value, Range)
    except msgspec.ValidationError as error:
        raise RangeError(f"{where} is not a pair [least, greatest] of numbers; give two") from error
    if not low <= high:
        raise RangeError(f"{where} = [{low:g}, {high:g}] has its ends swapped; swap them")
    if name == START and not 0.0 <= low <= high <= 1.0:
        raise RangeError(
            f"{where} = [{low:g}, {high:g}] is outside 0 to 1, the share of the starts; give 0 to 1"
        )
    if name == SEED and not (low >= 0.0 and low.is_integer() and high.is_integer()):
        raise RangeError(
            f"{where} = [{low:g}, {high:g}] is not a range of seeds; give whole numbers from 0"
        )
    return low, high


@dataclass(frozen=True)
class Space:
    """Everything that a search may choose for a scenario in its world.

    Attributes:
        scenario: board and starts.
        config: as calibrated; its world applies where there is no range.
        declared: ranges by name; where one of DEFAULT is missing and has an effect, that holds.

    Raises:
        RangeError: a range has no effect, or none is left.
        WorldError: the world allows less than a range.
        ConfigError: the parameters at an end of the ranges do not fit together.
    """

    scenario: Scenario
    config: CoSimConfig
    declared: Mapping[str, Range]

    def __post_init__(self) -> None:
        self._config_at(0)
        for name in self.declared:
            if name in self._without_effect:
                why = self._without_effect[name]
                raise RangeError(f"ranges.{name} has no effect {why}; leave it out")
        if not self.coordinates:
            raise RangeError("all ranges are fixed; give one with different ends")

    @cached_property
    def ranges(self) -> dict[str, Range]:
        """All that have an effect, by name."""
        default = {k: v for k, v in DEFAULT.items() if k not in self._without_effect}
        if self.config.world.motor_phases_deg:
            del default[PHASE]
        return default | dict(self.declared)

    @cached_property
    def coordinates(self) -> tuple[str, ...]:
        """Return the meaning of each coordinate of a vector, such as "start of r1"."""
        several = [r for r, c in zip(self._robots, self._chains, strict=True) if len(c) > 1]
        of = {START: several, PHASE: self._motors}
        searched = [name for name in NAMES if len(set(self.ranges.get(name, (0.0,)))) > 1]
        return tuple(
            f"{name} of {whose}" if whose else name
            for name in searched
            for whose in of.get(name, [""])
        )

    @property
    def steps(self) -> np.ndarray:
        """(D,) how far the next episodes of a search shall be from a bad one, as deviations."""
        return np.array([_STEPS.get(name.partition(" ")[0], _STEP) for name in self.coordinates])

    def point(self, vector: np.ndarray) -> ChosenEpisode:
        """The episode of a vector.

        Args:
            vector: (D,) of the `coordinates`; any real numbers.

        Raises:
            RangeError: a robot finds no start next to the others.
        """
        shares = dict(zip(self.coordinates, folded(vector).tolist(), strict=True))

        def at(name: str, whose: str = "") -> float:
            low, high = self.ranges[name]
            return low + (high - low) * shares.get(f"{name} of {whose}" if whose else name, 0.0)

        world = self._world({name: at(name) for name in OF_WORLD if name in self.ranges})
        if PHASE in self.ranges:
            turned = any(self.ranges[PHASE])
            phases = tuple(at(PHASE, motor) for motor in self._motors) if turned else ()
            world = msgspec.structs.replace(world, motor_phases_deg=phases)
        low, high = self.ranges.get(SEED, (0.0, 0.0))
        seed = min(int(low + (high - low + 1.0) * shares.get(SEED, 0.0)), int(high))
        shares_of_starts = [at(START, r) if START in self.ranges else 0.0 for r in self._robots]
        return ChosenEpisode(self._starts(shares_of_starts), seed, world)

    @property
    def _robots(self) -> list[str]:
        return [f"r{k + 1}" for k in range(self.scenario.robots)]

    @property
    def _motors(self) -> list[str]:
        return [f"{robot}.{motor}" for robot in self._robots for motor in MOTOR_NAMES]

    def _world(self, values: Mapping[str, float]) -> World:
        own: dict[str, Any] = {n: v for n, v in values.items() if n not in OF_SENSOR}
        camera = {n.partition(".")[2]: v for n, v in values.items() if n in OF_SENSOR}
        if camera:
            own["sensor"] = msgspec.structs.replace(self.config.world.camera, **camera)
        return msgspec.structs.replace(self.config.world, **own)

    def _config_at(self, end: int) -> CoSimConfig:
        """The configuration at the least or greatest values that are declared, which is checked."""
        values = {name: ends[end] for name, ends in self.declared.items() if name in OF_WORLD}
        phases = (self.declared.get(PHASE, (0.0, 0.0))[end],)
        msgspec.structs.replace(self.config.world, motor_phases_deg=phases)
        return self.config.in_world(self._world(values))

    @cached_property
    def _without_effect(self) -> dict[str, str]:
        """Return why a range has no effect, by its name."""
        config = self._config_at(1)
        world, controlled = config.world, "motors" not in config.open_loop
        sensor = world.camera
        blurred = sensor.position_noise_mm or sensor.heading_noise_deg or sensor.dropout
        noisy = controlled and config.noise.relative_amplitude > 0.0
        why = {}
        if all(len(cells) == 1 for cells in self.scenario.starts):
            why[START] = "where every robot has one start"
        if not (noisy or world.draws or blurred or config.shield):  # its detours are drawn
            why[SEED] = "where nothing is drawn"
        if not controlled:
            why["motor_speed_noise"] = "with --open-loop motors, which measure no speed"
        return why

    @cached_property
    def _chains(self) -> tuple[tuple[Cell, ...], ...]:
        return tuple(map(chained, self.scenario.starts))

    def _starts(self, shares: list[float]) -> tuple[Cell, ...]:
        """The cells at those shares of the chains, or the nearest ones without contact."""
        found: list[Cell] = []
        for robot, (share, chain) in enumerate(zip(shares, self._chains, strict=True)):
            wanted = min(int(share * len(chain)), len(chain) - 1)
            for k in sorted(range(len(chain)), key=lambda k: abs(k - wanted)):
                x, y = chain[k]
                squared = ((x - a) ** 2 + (y - b) ** 2 for a, b in found)
                if all(distance > self.scenario.squared_contact for distance in squared):
                    found.append(chain[k])
                    break
            else:
                raise RangeError(
                    f"robot {robot + 1} finds no start next to {found}; narrow ranges.start"
                )
        return tuple(found)


def folded(vector: np.ndarray) -> np.ndarray:
    """Coordinates between 0 and 1, mirrored at both ends."""
    period = np.mod(vector, 2.0)
    return np.where(period > 1.0, 2.0 - period, period)


def chained(cells: tuple[Cell, ...]) -> tuple[Cell, ...]:
    """Cells in an order in which neighbours are near: from the least, always on to the nearest."""
    left = np.array(sorted(cells))
    here, order = left[0], []
    while len(left):
        nearest = int(((left - here) ** 2).sum(axis=1).argmin())
        here, left = left[nearest], np.delete(left, nearest, axis=0)
        order.append((int(here[0]), int(here[1])))
    return tuple(order)

"""Episodes that are advanced together: their robots share the lanes of vectors, and the motors.

Every RL step, each running episode decides, all of them are simulated in one call, and each is
judged. An episode that has ended leaves its place to another one at the next RL step. What becomes
of an episode depends neither on what else is in the batch nor on the number of lanes.
"""

import copy
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.arguments import ConfigError, require_one_of, validate_argument
from cosim.base.errors import UserError, shorten
from cosim.coupling.assembly import check_motors, new_plant, robot_properties, why_not_fmpy
from cosim.coupling.master import (
    CompiledDriver,
    Driver,
    FaultError,
    FmpyDriver,
    ReferenceDriver,
)
from cosim.coupling.rl_step import SAMPLED, Step
from cosim.coupling.signals import (
    RawSamples,
    Samples,
    columns_of,
    each_array,
    new_raw_samples,
    new_samples,
    new_state,
    with_room,
    with_sight,
)
from cosim.fmi.motor import MotorFmu
from cosim.fmi.motors import Motors
from cosim.model.config import CoSimConfig
from cosim.model.scenario import Cell, Scenario
from cosim.model.world import World, motor_phases
from cosim.onboard.camera import NOISE, SIGHT, frames_in_flight, frames_within
from cosim.physics.feet import NO_FLOOR, OWN_MU, floor_margin
from cosim.physics.lanes import host_lanes
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.measures import PATH_SAMPLING_S, Measures

DRIVERS: dict[str, type[Driver]] = {
    "fmpy": FmpyDriver,
    "compiled": CompiledDriver,
    "reference": ReferenceDriver,
}
IN_LANES = ("fmpy", "compiled")

# Robots that a batch has room for: two vectors of eight lanes, four of four. More would share the
# cost of a call to the motors further, fewer wait for the last episode of a series.
ROBOTS_TOGETHER = 16
MOST_CURVE = 0.5  # assumed: of a cell, the radius of a circle in which a robot may turn


def places_for(driver: str, robots: int, tasks: int, threads: int) -> int:
    """Return the places of a batch: as many as fill its vectors, at most a thread's tasks."""
    if driver not in IN_LANES:
        return 1
    return max(1, min(ROBOTS_TOGETHER // robots, -(-tasks // threads)))


def chosen_driver(name: str | None, motor_fmu: Path, config: CoSimConfig) -> str:
    """Return a driver's name; by default fmpy, or compiled where fmpy cannot step the motors."""
    if name is None:
        return "compiled" if why_not_fmpy(MotorFmu(motor_fmu), config) else "fmpy"
    return name


def shared(config: CoSimConfig) -> tuple[Any, ...]:
    """Return what a batch must share: all but the world, the floor's friction, the speed noise."""
    own = ("robot", "noise", "world", "preset", "sources")
    same = [value for name, value in vars(config).items() if name not in own]
    return config.robot._replace(mu=0.0), config.noise.hold_s, *same


class Batch:
    """Places for K episodes of N robots each, advanced together in RL steps.

    Attributes:
        state: variables of all columns; another record after `begin` and `set_state`.
    """

    def __init__(
        self,
        motor_fmu: Path,
        config: CoSimConfig,
        robots: int,
        places: int,
        driver: str = "compiled",
        lanes: int | None = None,
    ) -> None:
        """Prepare K places for episodes of N robots, with a configuration unless given another.

        Args:
            lanes: bodies in a vector of a driver of IN_LANES, a power of two; by default 2 for up
                to two robots, else what the processor has: every number is compiled on its own.
        """
        self._arguments = motor_fmu, config, robots, places, driver, lanes
        require_one_of("driver", driver, DRIVERS)
        if lanes is not None and driver not in IN_LANES:
            raise ConfigError(
                f"lanes = {lanes} has no effect with the driver {driver}; leave it out"
            )
        fmu = MotorFmu(validate_argument("motor_fmu", motor_fmu, Path))
        check_motors(fmu, config, places * robots)
        if driver == "fmpy" and (reason := why_not_fmpy(fmu, config)):
            raise ConfigError(f"--driver fmpy cannot be used: {reason}; use --driver compiled")
        self.config = config
        self.robots = robots
        if driver not in IN_LANES:
            lanes = 1
        elif lanes is None:
            lanes = 2 if places * robots <= 2 else host_lanes()
        columns = columns_of(places * robots, lanes)
        self._motors = Motors(fmu, config, columns, sampled=driver == "fmpy")
        self.driver = DRIVERS[driver](self._motors, lanes)
        self.plant = new_plant(config, robots, end_on_collision=config.on_collision == "end")
        self._sizes = config.robot.sizes
        self.state = new_state(places, robots, columns, self._sizes)
        self.state.bodies.properties[:] = robot_properties(config)[:, None]
        self.episodes: list[RunningEpisode | None] = [None] * places

    def begin(
        self,
        place: int,
        scenario: Scenario,
        starts: tuple[Cell, ...],
        seed: np.random.SeedSequence,
        config: CoSimConfig | None = None,
        kind: type[RunningEpisode] = RunningEpisode,
        sampled: tuple[int, ...] | None = None,
    ) -> RunningEpisode:
        """Begin an episode, motors at rest; one that was there is given up.

        Its configuration is by default the batch's, see `shared`; the rest is as of
        `RunningEpisode`.
        """
        config = config or self.config
        if shared(config) != shared(self.config):
            raise ConfigError(
                "an episode differs from its batch by more than its world; make another batch "
                "for it"
            )
        if scenario.robots != self.robots:
            raise ConfigError(
                f"scenario {scenario.name} has {scenario.robots} robots, a place of the batch "
                f"{self.robots}; make another batch for it"
            )
        starts = validate_argument("starts", starts, tuple[Cell, ...])
        if len(starts) != self.robots:
            raise ConfigError(f"starts = {shorten(starts)} must have a cell for each robot")
        if config.robot.diameter_m != scenario.diameter_m:
            raise ConfigError(
                f"diameter_m = {config.robot.diameter_m:g} of the configuration is not "
                f"robot_diameter_m = {scenario.diameter_m:g} of scenario {scenario.name}; "
                "use config.sized(scenario.diameter_m)"
            )
        radius_m = config.steering.turn_radius_m
        if radius_m > MOST_CURVE * scenario.cell_m:
            raise ConfigError(
                f"machine {config.preset} cannot turn on the spot: it drives in circles of radius "
                f"{1e3 * radius_m:.0f} mm, but cells of scenario {scenario.name} are "
                f"{1e3 * scenario.cell_m:g} mm wide; make them {1e3 * radius_m / MOST_CURVE:.0f} "
                "mm or wider"
            )
        columns = self._columns(place)
        state = self.state
        motors, bodies = state.motors, state.bodies
        rows = motors.inputs, motors.outputs, motors.held, bodies.held_velocities, bodies.statistics
        for signals in rows:
            signals[:, columns] = 0.0  # nothing is left of the episode before
        bodies.unsolved[columns] = 0.0
        self._lay_floor(place, scenario, config)
        phases = motor_phases(config.world, self.robots, len(config.robot.motors))
        episode = kind(scenario, config, self.state, columns, starts, seed, sampled)
        of_robots = range(columns.start, columns.stop)
        start = self._motors.restart(of_robots, episode.drawn.motors, phases)
        motors.outputs[: len(start), columns] = start
        self.state.episodes.running[place] = 1
        self.episodes[place] = episode
        return episode

    def _lay_floor(self, place: int, scenario: Scenario, config: CoSimConfig) -> None:
        """Put an episode's board in place, and make room for frames of its camera."""
        walls, patches = scenario.walls * scenario.cell_m, floor_patches(scenario, config)
        closed, columns = scenario.closed * scenario.cell_m, self._columns(place)
        targets, owners = scenario.parking
        frames = frames_in_flight(config.world.camera)
        self.state = with_room(self.state, len(walls), len(patches), closed.shape[1], frames)
        floor = self.state.floor
        floor.boards[place], floor.cells_m[place] = scenario.size_m, scenario.cell_m
        floor.margins_m[place] = floor_margin(config.robot, config.world)
        floor.obstacles[place] = floor.patches[place] = np.inf
        floor.obstacles[place, : len(walls)] = walls
        floor.forbidden[columns] = np.inf
        floor.forbidden[columns, : closed.shape[1]] = closed
        floor.targets[columns] = targets * scenario.cell_m
        floor.owners[columns] = columns.start + owners
        floor.patches[place, : len(patches)] = patches

    def advance(self, actions: Mapping[int, np.ndarray]) -> dict[int, Step]:
        """Simulate one RL step of all running episodes by (N,) actions; both by their places."""
        going_on = self.going_on()
        for place, episode in going_on.items():
            episode.begin_step(actions[place])
        for samples, raw in self.stretches():
            for place, episode in going_on.items():
                if periods := int(self.state.episodes.periods[place]):
                    episode.take(samples, raw, periods)
        steps = {place: episode.end_step() for place, episode in going_on.items()}
        for place, step in steps.items():
            if step.outcome:
                self.stop(place)
        return steps

    def stretches(self) -> Iterator[tuple[Samples, RawSamples]]:
        """Simulate one RL step of all running episodes by the commands in `state`, not judged.

        Yields:
            Samples of all columns in a stretch of the step, written again in the next one. Each
            episode did `state.episodes.periods` control periods of it. Many robots have several.
        """
        state, going_on = self.state, self.going_on()
        if not going_on:
            raise UserError("no episode is running in this batch, or it is closed; begin one first")
        periods, columns = self.config.periods_per_step, state.bodies.motion.shape[1]
        step_s = self.config.timing.rl_step_s
        frames = [frames_within(e.config.world.camera, step_s) for e in going_on.values()]
        sight = np.zeros((max(frames), columns, NOISE))
        state.onboard.cameras[:, SIGHT] = 0.0
        for (place, episode), count in zip(going_on.items(), frames, strict=True):
            episode.draw_camera(sight[:count, self._columns(place)])
        sighted = with_sight(state, sight)
        noise = np.zeros((periods, columns, self._sizes[0]))
        for place, episode in going_on.items():
            noise[:, self._columns(place)] = episode.noise.draw(periods)
        stretch = min(-(-periods // -(-self.robots // SAMPLED)), periods)
        samples = new_samples(stretch, columns, self._sizes)
        burst = round(self.config.timing.burst_s / self.config.timing.dt_s)
        ticks = min(burst, stretch * self.config.ticks_per_period)
        raw = new_raw_samples(ticks, columns, self._sizes)
        begin_s = min(episode.time_s for episode in going_on.values())
        for begin in range(0, periods, stretch):
            state.episodes.periods[:] = 0
            part = noise[begin : begin + stretch]
            try:
                self.driver.advance(self.plant, sighted, part, samples, raw)
            except FaultError as error:
                place, robot = divmod(error.column, self.robots)
                name, start_s = f"robot {robot + 1}", begin_s
                if place in going_on:
                    start_s = going_on[place].time_s
                else:  # all lanes of a vector are computed
                    name += " of a place without an episode"
                end_s = start_s + error.ticks * self.config.timing.dt_s
                raise error.locate(name, end_s, self.config.preset) from None
            yield samples, raw
            for place, episode in going_on.items():
                episode.pass_periods(int(state.episodes.periods[place]))
            raw = RawSamples(*(signal[:0] for signal in raw))

    def going_on(self) -> dict[int, RunningEpisode]:
        """Running episodes, by place."""
        return {
            place: episode
            for place, episode in enumerate(self.episodes)
            if episode is not None and self.state.episodes.running[place]
        }

    def stop(self, place: int) -> None:
        """Stop an episode; its robots stand still from now on."""
        columns = self._columns(place)
        self.state.episodes.running[place] = 0
        self.state.bodies.ended[:, columns] = self.state.bodies.motion[:, columns]

    def _columns(self, place: int) -> slice:
        return slice(place * self.robots, (place + 1) * self.robots)

    def compile(self) -> None:
        """Compile the kernels, or load them from the cache, by simulating nothing."""
        columns = self.state.bodies.motion.shape[1]
        noise = np.zeros((0, columns, self._sizes[0]))
        samples = new_samples(0, columns, self._sizes)
        raw = new_raw_samples(0, columns, self._sizes)
        self.driver.advance(self.plant, self.state, noise, samples, raw)
        # Arrays without rows would be contiguous, and compile another version.
        still = Measures(np.zeros((columns, 2)), np.zeros(columns), PATH_SAMPLING_S)
        still.add(new_samples(2, columns, self._sizes))

    def get_state(self) -> tuple[Any, ...]:
        """Return a copy of all that changes, for `set_state`; it can be pickled."""
        return each_array(np.copy, self.state), _copies(self.episodes), self._motors.get_state()

    def set_state(self, saved: tuple[Any, ...]) -> None:
        """Go back to a state of this batch, or of one made with the same arguments.

        What follows has the bits that followed then.
        """
        state, episodes, motors = saved
        if len(episodes) != len(self.episodes):
            raise ConfigError(
                f"a state of {len(episodes)} episodes does not fit {len(self.episodes)}; "
                "restore it where as many run"
            )

        def taken(mine: np.ndarray, its: np.ndarray) -> np.ndarray:
            if mine.shape != its.shape:
                return its.copy()
            mine[:] = its
            return mine

        self.state = each_array(taken, self.state, state)
        self.episodes = _copies(episodes)
        for episode in self.episodes:
            if episode is not None:
                episode.bind(self.state)
        self._motors.set_state(motors)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copies and pickles have FMU instances of their own, in the same state."""
        return Batch, self._arguments, self.get_state()

    __setstate__ = set_state

    def close(self) -> None:
        """Free the FMU instances, and give up all episodes."""
        self.state.episodes.running[:] = 0
        self._motors.close()


def _copies(episodes: list[RunningEpisode | None]) -> list[RunningEpisode | None]:
    """Return copies of episodes that share what never changes."""
    constant = [x for e in episodes if e is not None for x in (e.scenario, e.config, e.drawn)]
    return copy.deepcopy(episodes, {id(x): x for x in constant})


def floor_patches(scenario: Scenario, config: CoSimConfig) -> np.ndarray:
    """Return `Floor.patches` of an episode, shape (P, 5)."""
    world = config.world
    beyond = (-math.inf, -math.inf, math.inf, math.inf, NO_FLOOR)
    board = [beyond, (0.0, 0.0, *scenario.size_m, OWN_MU)] if world.edge else []
    return np.array([*board, *world_patches(scenario, world)]).reshape(-1, 5)


def world_patches(scenario: Scenario, world: World) -> list[tuple[float, ...]]:
    """Return rectangles in m and friction coefficients of a world's patches, 5 numbers each."""
    ends = [
        (*patch.cells[:2], *(cell + 1 for cell in patch.cells[2:])) for patch in world.mu_patches
    ]
    edges = scenario.cell_m * np.array(ends).reshape(-1, 4)
    mus = (patch.mu for patch in world.mu_patches)
    return [(*own.tolist(), mu) for own, mu in zip(edges, mus, strict=True)]

"""One co-simulated episode as a Rerun recording: every signal of every RL step.

What is recorded, and how often, is `cosim.recording.series`, what moves in the 3D view
`cosim.recording.scene`, the log as text `cosim.recording.episode_log`. A thread writes stretches of
many RL steps while the simulation continues, one chunk per entity: few long chunks are written,
stored and read several times faster than many short ones, and Rerun keeps an index of all of them
in memory.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
from rerun.chunk import Chunk

from cosim.coupling.rl_step import POSES_S, Decision, Step, sampled_of
from cosim.model.config import CoSimConfig
from cosim.model.params import RobotParams
from cosim.model.scenario import Scenario
from cosim.model.world import Patch
from cosim.onboard.features import DISTANCE_CLASSES, GRADIENT_SIGNS, Observation
from cosim.onboard.steering import DIRECT, MODE_NAMES
from cosim.physics.draws import Drawn
from cosim.recording import series
from cosim.recording.blueprint import episode_blueprint
from cosim.recording.episode_log import EpisodeLog, write_lines, write_run_page
from cosim.recording.file import Kept, Recording, scalars, simulated
from cosim.recording.scene import SWARM, RobotScene, write_floor, write_scene, write_styles

_STRETCH_S = 20.0  # simulated time that is handed to the thread at once
_STRETCH_ROBOT_S = 160.0  # of many robots less: a robot's samples of 20 s take 10 MB
_MINUTE_S = 60.0  # simulated time that is written together: what a killed process can lose
# So that little is left to write at the end, a short episode's longest entities are written by
# stretches.
_SHORT_S = 120.0
_MANY_ROWS = 5000
_ROUNDING_S = 1e-9
_LABEL_HEIGHTS = 0.2  # of the board, above it


class _Decided(NamedTuple):
    """An RL step with what the agent thought of it."""

    step: Step
    decision: Decision
    reward_parts: np.ndarray


class EpisodeRecorder:
    """Writes one episode; a context manager that completes the file, also after an error.

    A thread does the work. What goes wrong in it is raised by the next call of `write`, or at the
    end.

    Args:
        config: parameters; its `burst_s` should be that of the level.
        sampled: indices of the robots whose signals steps have; by default `sampled_of`. If these
            are not all, of the others the poses are recorded, together in one entity.
    """

    def __init__(
        self,
        path: Path | Kept,
        scenario: Scenario,
        config: CoSimConfig,
        recording_id: str,
        facts: dict[str, Any],
        *,
        level: series.Level = "default",
        viewer: str | None = None,
        policies: Sequence[series.PolicyMap] = (),
        drawn: Drawn | None = None,
        sampled: tuple[int, ...] | None = None,
    ) -> None:
        if config.world.draws and drawn is not None:
            facts = facts | {"drawn": drawn.table()}
        self._sampled = sampled_of(scenario.robots) if sampled is None else sampled
        self._names, count = series.robot_names(self._sampled), len(self._sampled)
        self._all_sampled = count == scenario.robots
        self._scenario, self._config, self._detail = scenario, config, series.DETAILS[level]
        camera = config.world.camera.rate_hz > 0.0
        self._distances = count > 1 and self._all_sampled
        self._signals = series.signals_of(
            config.robot, distances=self._distances, camera=camera, full=self._detail.full
        )
        self._return = np.zeros(count)
        self._modes = np.full(count, -1.0)
        self._valued = False  # whether the unit of action values is written
        self._visited: list[set[tuple[int, int]]] = [set() for _ in self._names]
        self._stretch: list[_Decided] = []
        self._stretch_s = 0.0
        self._next_burst_s = 0.0
        self._next_flush_s, self._live = _MINUTE_S, viewer is not None
        self._log = EpisodeLog(scenario, config, self._sampled)
        self._thread = ThreadPoolExecutor(1, "recording")
        self._error: BaseException | None = None
        policies = [policy for robot, policy in enumerate(policies) if robot in self._sampled]
        blueprint = episode_blueprint(
            self._sampled,
            scenario.size_m,
            bursts=config.timing.burst_s > 0.0,
            policies=bool(policies),
            distances=self._all_sampled,
            camera=camera,
            machine=config.robot,
        )

        def opened() -> Recording | Kept:
            if isinstance(path, Path):
                return Recording(path, recording_id, blueprint, viewer)
            path.recording_id, path.blueprint = recording_id, blueprint
            return path

        self._waiting = self._later(lambda: self._open(opened(), level, facts, policies))

    def _open(
        self,
        file: Recording | Kept,
        level: series.Level,
        facts: dict[str, Any],
        policies: Sequence[series.PolicyMap],
    ) -> None:
        """Write what is known before the first RL step."""
        self._file, scenario = file, self._scenario
        known = {
            "record": level,
            "targets_m": [scenario.centre_m(t) for t in scenario.targets],
            "board_m": scenario.size_m,
            "friction": self._config.robot.mu,  # parameters have a mu, of another type
        }
        if not self._all_sampled:
            known["signals"] = [robot + 1 for robot in self._sampled]
        file.properties("episode", facts | known)
        file.properties("parameters", self._config.table())
        robot, patches = self._config.robot, self._config.world.mu_patches
        file.send(_unchanging(scenario, robot, patches, tuple(self._signals), self._sampled))
        file.states(series.OUTCOME, simulated(np.zeros(1)), [series.STILL_RUNNING])
        self._write_label(0.0, series.STILL_RUNNING)
        for name, policy in zip(self._names, policies, strict=False):
            write_floor(file, name, scenario, policy)
        write_run_page(file, facts, self._config)
        self._scenes = [
            RobotScene(file, name, robot, scenario.cell_m, self._config, self._detail)
            for robot, name in enumerate(self._names)
        ]
        file.flush()  # what is left of a killed process says at least what was run

    def __enter__(self) -> "EpisodeRecorder":
        return self

    def __exit__(self, _: object, raised: BaseException | None, __: object) -> None:
        with self._thread:
            self._hand_over()
            self._thread.submit(self._close)
        if self._error is not None and self._error is not raised:
            raise self._error

    def _close(self) -> None:
        """Complete the file, also after an error, which it then ends with."""
        if hasattr(self, "_file"):
            self._attempt(self._file.close)

    def _later(self, work: Callable[[], None]) -> Future[Any]:
        """Have something done in the thread, in turn; nothing more after an error."""
        return self._thread.submit(lambda: self._error or self._attempt(work))

    def _attempt(self, work: Callable[[], None]) -> None:
        try:
            work()
        except BaseException as error:
            self._error = self._error or error

    def set_property(self, name: str, values: dict[str, Any]) -> None:
        """Write a property of the recording."""
        self._later(lambda: self._file.properties(name, values))

    def write(
        self, step: Step, decision: Decision | None = None, reward_parts: np.ndarray | None = None
    ) -> None:
        """Take one RL step.

        Args:
            decision: of the policy at the start of the step, whether or not it was adopted; by
                default the action in force, without values.
            reward_parts: (N, 3) reward of the step as the sum of
                `cosim.recording.series.REWARD_PARTS`, NaN where none was.
        """
        if self._error is not None:
            raise self._error
        if reward_parts is None:
            reward_parts = np.full((self._scenario.robots, len(series.REWARD_PARTS)), np.nan)
        decision = decision or Decision(step.action)
        if not self._all_sampled:
            step, decision = step.of_sampled(), decision.of(self._sampled)
            reward_parts = reward_parts[list(self._sampled)]
        self._stretch.append(_Decided(step, decision, reward_parts))
        self._stretch_s += step.duration_s
        whole_s = min(_STRETCH_S, _STRETCH_ROBOT_S / max(1, len(self._names)))
        if self._stretch_s > whole_s - _ROUNDING_S:
            self._hand_over()

    def _hand_over(self) -> None:
        """Have the stretch written once the one before it is: no more than two are in memory."""
        self._waiting.result()
        stretch, self._stretch, self._stretch_s = self._stretch, [], 0.0
        self._waiting = self._later(lambda: self._write_stretch(stretch))

    def _write_stretch(self, stretch: list[_Decided]) -> None:
        if not stretch:
            return
        self._file.check_space()
        steps = [decided.step for decided in stretch]
        sampled = series.Stretch(steps, self._config.timing)
        end_s = self._end_s(steps[-1])
        whole = self._live or end_s > self._next_flush_s - _ROUNDING_S
        self._write_signals(sampled)
        if whole or end_s < _SHORT_S:
            self._file.send_rows(_MANY_ROWS)  # Rerun encodes them while the rest is made
        self._write_bursts([step for step in steps if self._burst_is_due(step)])
        for robot, name in enumerate(self._names):
            self._scenes[robot].write(steps, sampled)
            self._write_modes(steps, name, robot)
            self._write_decisions(stretch, name, robot)
            self._write_rewards(stretch, name, robot)
        self._valued = True
        if not self._all_sampled:
            self._write_swarm(steps)
        self._write_log(stretch)
        if whole:
            self._next_flush_s += _MINUTE_S
            self._file.flush()
        elif end_s < _SHORT_S:
            self._file.send_rows(_MANY_ROWS)

    def _write_signals(self, sampled: series.Stretch) -> None:
        timing = self._config.timing
        if not len(sampled.time_s):
            return
        for signal in self._signals:
            if signal.of is None or signal.rate == "burst":
                continue
            rate_s = getattr(self._detail, f"{signal.rate}_s")
            every = series.periods(rate_s, timing.control_period_s, timing.rl_step_s)
            values = sampled.rows(signal.of, every, signal.reduced)
            if np.isnan(values[0]).any():  # what the motor FMU does not tell
                continue
            times = simulated(sampled.time_s[sampled.ends(every)])
            for robot, name in enumerate(self._names):
                self._file.columns(signal.entity(name), times, scalars(values[:, robot]))

    def _write_swarm(self, steps: list[Step]) -> None:
        every = round(POSES_S / self._config.timing.dt_s)
        times = [
            self._config.timing.dt_s * (s.first_tick // every + 1 + np.arange(len(s.poses))) * every
            for s in steps
        ]
        poses = np.concatenate([step.poses for step in steps]).astype(np.float32)
        rows, robots, _ = poses.shape
        quaternions = np.roll(poses[..., 3:], -1, axis=2).reshape(-1, 4)
        placed = rr.InstancePoses3D.columns(
            translations=poses[..., :3].reshape(-1, 3), quaternions=quaternions
        )
        if rows:
            partitioned = placed.partition([robots] * rows)
            self._file.columns(SWARM, simulated(np.concatenate(times)), partitioned)

    def _burst_is_due(self, step: Step) -> bool:
        time_s = step.first_tick * self._config.timing.dt_s
        due = len(step.raw.omega) > 0 and time_s > self._next_burst_s - _ROUNDING_S
        if due:
            self._next_burst_s = time_s + self._detail.between_s
        return due

    def _write_bursts(self, steps: list[Step]) -> None:
        if not steps:
            return
        ticks = [s.first_tick + np.arange(1, len(s.raw.omega) + 1) for s in steps]
        times = simulated(self._config.timing.dt_s * np.concatenate(ticks))
        for signal in self._signals:
            if signal.rate == "burst" and signal.of is not None:
                values = np.concatenate([signal.of(step.raw) for step in steps])
                for robot, name in enumerate(self._names):
                    self._file.columns(signal.entity(name), times, scalars(values[:, robot]))

    def _write_decisions(self, stretch: list[_Decided], name: str, robot: int) -> None:
        """Write what was seen and decided at the start of each RL step, and seen at the end."""
        steps, decisions = [d.step for d in stretch], [d.decision for d in stretch]
        ticks, numbers = [s.first_tick for s in steps], [s.number for s in steps]
        seen = [step.before for step in steps]
        times = simulated(self._config.timing.dt_s * np.array(ticks), numbers)
        actions = [_action_name(step, robot) for step in steps]
        self._file.states(f"/rl/{name}/action", times, actions)
        values = [d.values[robot] for d in decisions if d.values is not None]
        if len(values) == len(decisions):
            if not self._valued:
                self._file.static(f"/rl/{name}/q_s", rr.AnyValues(unit=decisions[0].unit))
            self._write_numbers(name, times, q_s=np.array(values))
            greedy = [series.DIRECTION_NAMES[int(d.action[robot])] for d in decisions]
            self._file.states(f"/rl/{name}/greedy", times, greedy)
        if steps[-1].outcome:
            seen.append(steps[-1].after)
            end_s = np.append(self._config.timing.dt_s * np.array(ticks), self._end_s(steps[-1]))
            times = simulated(end_s, [*numbers, numbers[-1]])
        self._write_observations(name, robot, seen, times)

    def _write_numbers(self, name: str, times: list[rr.TimeColumn], **signals: np.ndarray) -> None:
        for path, values in signals.items():
            self._file.columns(f"/rl/{name}/{path}", times, scalars(values))

    def _write_modes(self, steps: list[Step], name: str, robot: int) -> None:
        """Write the mode of the steering whenever it is another one."""
        dt, ticks = self._config.timing.dt_s, self._config.ticks_per_period
        times, names = [], []
        for step in steps:
            modes = step.samples.mode[:, robot]
            changed = np.flatnonzero(np.diff(modes, prepend=self._modes[robot]))
            times += (dt * (step.first_tick + ticks * changed)).tolist()
            names += [MODE_NAMES[int(mode)] for mode in modes[changed]]
            self._modes[robot] = modes[-1] if len(modes) else self._modes[robot]
        if times:
            self._file.states(f"/rl/{name}/steering", simulated(np.array(times)), names)

    def _write_observations(
        self, name: str, robot: int, seen: list[Observation], times: list[rr.TimeColumn]
    ) -> None:
        cells = np.array([observation.cells for observation in seen])
        visited = []
        for x, y in cells[:, robot].tolist():
            self._visited[robot].add((x, y))
            visited.append(len(self._visited[robot]))
        self._write_numbers(name, times, cell=cells[:, robot], visited=np.array(visited))
        if self._distances:
            distances = np.linalg.norm(cells - cells[:, robot : robot + 1], axis=2)
            nearest = np.delete(distances, robot, axis=1).min(axis=1)
            self._write_numbers(name, times, distance=nearest)
        signs = [GRADIENT_SIGNS[int(observation.gradient_sign[robot]) + 1] for observation in seen]
        self._file.states(f"/rl/{name}/gradient", times, signs)
        classes = [DISTANCE_CLASSES[observation.distance_class[robot]] for observation in seen]
        self._file.states(f"/rl/{name}/distance_class", times, classes)

    def _write_rewards(self, stretch: list[_Decided], name: str, robot: int) -> None:
        earned = [d for d in stretch if not np.isnan(d.reward_parts[robot]).any()]
        if not earned:
            return
        ends_s = np.array([self._end_s(d.step) for d in earned])
        times = simulated(ends_s, [d.step.number for d in earned])
        parts = np.array([d.reward_parts[robot] for d in earned])
        reward = parts.sum(axis=1)
        total = self._return[robot] + reward.cumsum()
        self._write_numbers(name, times, reward=reward, reward_parts=parts, **{"return": total})
        self._return[robot] += reward.sum()

    def _write_log(self, stretch: list[_Decided]) -> None:
        told = (self._log.lines(step, parts.sum(axis=1)) for step, _, parts in stretch)
        lines = [line for lines in told for line in lines]
        write_lines(self._file, lines)
        for line in lines:
            if line.entity == series.OUTCOME:
                self._write_label(line.time_s, line.state)

    def _write_label(self, time_s: float, outcome: str) -> None:
        """Write the outcome above the board: the end of a timeline has no room for it."""
        width, height = self._scenario.size_m
        at = [(width / 2.0, height, _LABEL_HEIGHTS * height)]
        label = rr.Points3D.columns(
            positions=at, labels=[outcome], colors=[series.WHITE], radii=[0.0]
        )
        self._file.columns("/world/outcome", simulated(np.array([time_s])), label)

    def _end_s(self, step: Step) -> float:
        ticks = step.first_tick + self._config.ticks_per_period * len(step.samples.omega)
        return ticks * self._config.timing.dt_s


@lru_cache(maxsize=8)
def _unchanging(
    scenario: Scenario,
    robot: RobotParams,
    patches: tuple[Patch, ...],
    signals: tuple[series.SignalSpec, ...],
    sampled: tuple[int, ...],
) -> list[Chunk]:
    """Return the scene and the styles of all signals."""
    kept = Kept()
    write_scene(kept, scenario, robot, patches, sampled)
    write_styles(kept, signals, sampled)
    return kept.chunks


def _action_name(step: Step, robot: int) -> str:
    """Return what a robot does in an RL step: a direction, commanded motors, or nothing more."""
    if (action := int(step.action[robot])) >= 0:
        return series.DIRECTION_NAMES[action]
    return series.DRIVEN if step.samples.mode[0, robot] == DIRECT else series.ARRIVED

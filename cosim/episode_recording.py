"""One co-simulated episode as a Rerun recording: every signal of every RL step.

Motor speeds and voltages are written at the control period (1 kHz), everything slower at 50 Hz
(velocities and currents as means, contact forces as maxima over 20 ms), and the first 10 ms of
every RL step at every tick. Some RL steps are written together, one chunk per entity: few long
chunks are written, stored and read several times faster than many short ones.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rerun as rr

from cosim.blueprint import episode_blueprint, robot_names
from cosim.config import CoSimConfig
from cosim.episode import Step
from cosim.features import GRADIENT_SIGNS, Observation
from cosim.recording import Recording, properties, scalars, simulated
from cosim.scenario import Scenario
from cosim.scene import write_scene
from cosim.series import ARRIVED, DIRECTION_NAMES, RAW_SERIES, write_styles
from cosim.signals import RawSamples, Samples

# A row costs 35 bytes whatever it holds: only what changes within a motor turn is written faster.
SLOW_PERIOD_S = 0.02
TRAIL_PERIOD_S = 0.5
_BATCH_STEPS = 5  # RL steps written together: what a killed process can lose
_METRES_PER_NEWTON = 0.03
_TRAIL_HEIGHT_M = 0.0005


class _Decided(NamedTuple):
    """An RL step with what the agent thought of it."""

    step: Step
    q_values: np.ndarray
    reward: np.ndarray


class EpisodeRecorder:
    """Writes one episode; a context manager that completes the file, also after an error.

    Args:
        path: of the recording.
        scenario: board, targets, number of robots.
        config: parameters.
        recording_id: identity of the recording; equal runs use equal ones.
        facts: seed, versions and what else identifies the run, for the properties and `/info/run`.

    Raises:
        RecordingError: the file cannot be written.
    """

    def __init__(
        self,
        path: Path,
        scenario: Scenario,
        config: CoSimConfig,
        recording_id: str,
        facts: dict[str, Any],
    ) -> None:
        self._names = robot_names(scenario.robots)
        self._config = config
        self._every = max(1, round(SLOW_PERIOD_S / config.timing.control_period_s))
        self._return = np.zeros(scenario.robots)
        self._trail: list[np.ndarray] = []
        self._batch: list[_Decided] = []
        blueprint = episode_blueprint(scenario.robots, scenario.size_m)
        self.file = Recording(path, recording_id, blueprint)
        self.file.stream.send_property("episode", properties(facts))
        write_scene(self.file, scenario, config.robot)
        write_styles(self.file, scenario.robots)
        page = rr.TextDocument(_run_document(facts, config), media_type="text/markdown")
        self.file.static("/info/run", page)

    def __enter__(self) -> "EpisodeRecorder":
        return self

    def __exit__(self, *_: object) -> None:
        self._write_batch()
        self.file.close()

    def write(self, step: Step, q_values: np.ndarray, reward: np.ndarray) -> None:
        """Take one RL step.

        Args:
            step: what the co-simulation returned.
            q_values: (N, 8) action values of the observation before the step.
            reward: (N,) reward of a move completed in the step, NaN where none was.

        Raises:
            RecordingError: the disk is full.
        """
        self.file.check_space()
        self._batch.append(_Decided(step, q_values, reward))
        if len(self._batch) == _BATCH_STEPS:
            self._write_batch()

    def _write_batch(self) -> None:
        if not self._batch:
            return
        steps = [decided.step for decided in self._batch]
        samples = Samples(*map(np.concatenate, zip(*(s.samples for s in steps), strict=True)))
        raw = RawSamples(*map(np.concatenate, zip(*(s.raw for s in steps), strict=True)))
        dt, ticks = self._config.timing.dt_s, self._config.ticks_per_period
        times = [s.first_tick + ticks * np.arange(1, len(s.samples.omega) + 1) for s in steps]
        time_s = dt * np.concatenate(times)
        bursts = [s.first_tick + np.arange(1, len(s.raw.omega) + 1) for s in steps]
        raw_time_s = dt * np.concatenate(bursts)
        trail_every = round(TRAIL_PERIOD_S / self._config.timing.control_period_s)
        self._trail.extend(samples.position[::trail_every])
        for robot, name in enumerate(self._names):
            for signal in RAW_SERIES:
                self._send(f"/raw/{name}/{signal}", raw_time_s, getattr(raw, signal)[:, robot])
            self._write_signals(name, robot, samples, time_s)
            self._write_scene(name, robot, samples, time_s)
            self._write_decisions(name, robot)
            self._write_rewards(name, robot)
        self._write_log()
        self.file.flush()
        self._batch.clear()

    def _send(
        self, entity: str, time_s: np.ndarray, values: np.ndarray, rl_step: Any = None
    ) -> None:
        if len(time_s):
            self.file.columns(entity, simulated(time_s, rl_step), scalars(values))

    def _write_signals(self, name: str, robot: int, samples: Samples, time_s: np.ndarray) -> None:
        blocks = len(time_s) // self._every
        slow = slice(self._every - 1, blocks * self._every, self._every)
        slow_s = time_s[slow]

        def by_block(signal: str) -> np.ndarray:
            values = getattr(samples, signal)[: blocks * self._every, robot]
            return values.reshape(blocks, self._every, *values.shape[1:])

        w, x, y, z = samples.quaternion[slow, robot].T
        heading = np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))
        fast = {"motors/omega": samples.omega, "motors/voltage": samples.voltage}
        for path, values in fast.items():
            self._send(f"/sim/{name}/{path}", time_s, values[:, robot])
        for path, values in {
            "motors/current": by_block("current").mean(axis=1),
            "motors/omega_des": samples.omega_des[slow, robot],
            "motors/theta": samples.theta[slow, robot],
            "position": samples.position[slow, robot, :2],
            "velocity": by_block("velocity")[..., :2].mean(axis=1),
            "heading": heading,
            "heading_error": samples.heading_error[slow, robot],
            "contact/normal_max": by_block("normal_max").max(axis=1),
            "contact/friction_max": by_block("friction_max").max(axis=1),
            "contact/lifted_share": by_block("lifted_share").mean(axis=1),
            "contact/touching_share": by_block("touching_share").mean(axis=1),
        }.items():
            self._send(f"/sim/{name}/{path}", slow_s, values)

    def _write_scene(self, name: str, robot: int, samples: Samples, time_s: np.ndarray) -> None:
        slow = slice(self._every - 1, None, self._every)
        position, normal = samples.position[slow, robot], samples.normal_max[slow, robot]
        if len(position):
            times = simulated(time_s[slow])
            # Rerun wants (x, y, z, w).
            quaternion = np.roll(samples.quaternion[slow, robot], -1, axis=1)
            pose = rr.Transform3D.columns(translation=position, quaternion=quaternion)
            self.file.columns(f"/world/{name}/robot", times, pose)
            arrows = np.zeros((*normal.shape, 3))
            arrows[:, :, 2] = _METRES_PER_NEWTON * normal
            forces = rr.Arrows3D.columns(vectors=arrows.reshape(-1, 3))
            forces = forces.partition([normal.shape[1]] * len(normal))
            self.file.columns(f"/world/{name}/robot/contact", times, forces)
        trail = np.array(self._trail)[:, robot].copy()
        trail[:, 2] = _TRAIL_HEIGHT_M
        line = rr.LineStrips3D.columns(strips=[trail])
        self.file.columns(f"/world/{name}/trail", simulated(time_s[-1:]), line)

    def _write_decisions(self, name: str, robot: int) -> None:
        """What was seen and decided at the start of each RL step, and seen at the very end."""
        times, numbers = self._starts()
        seen = [decided.step.before for decided in self._batch]
        action = [int(decided.step.action[robot]) for decided in self._batch]
        names = [DIRECTION_NAMES[a] if a >= 0 else ARRIVED for a in action]
        states = rr.StateChange.columns(state=names)
        self.file.columns(f"/rl/{name}/action", simulated(times, numbers), states)
        q_values = np.array([decided.q_values[robot] for decided in self._batch])
        self._send(f"/rl/{name}/q_s", times, q_values, numbers)
        last = self._batch[-1].step
        if last.outcome:
            seen.append(last.after)
            times = np.append(times, self._end_s(last))
            numbers = np.append(numbers, last.number)
        self._write_observations(name, robot, seen, times, numbers)

    def _write_observations(
        self,
        name: str,
        robot: int,
        seen: list[Observation],
        times: np.ndarray,
        numbers: np.ndarray,
    ) -> None:
        cells = np.array([observation.cells for observation in seen])
        self._send(f"/rl/{name}/cell", times, cells[:, robot], numbers)
        if len(self._names) > 1:
            distances = np.linalg.norm(cells - cells[:, robot : robot + 1], axis=2)
            nearest = np.delete(distances, robot, axis=1).min(axis=1)
            self._send(f"/rl/{name}/distance", times, nearest, numbers)
        signs = [GRADIENT_SIGNS[int(observation.gradient_sign[robot]) + 1] for observation in seen]
        states = rr.StateChange.columns(state=signs)
        self.file.columns(f"/rl/{name}/gradient", simulated(times, numbers), states)

    def _write_rewards(self, name: str, robot: int) -> None:
        earned = [d for d in self._batch if not np.isnan(d.reward[robot])]
        times = np.array([self._end_s(d.step) for d in earned])
        numbers = np.array([d.step.number for d in earned])
        reward = np.array([d.reward[robot] for d in earned])
        self._send(f"/rl/{name}/reward", times, reward, numbers)
        self._send(f"/rl/{name}/return", times, self._return[robot] + reward.cumsum(), numbers)
        self._return[robot] += reward.sum()

    def _write_log(self) -> None:
        """Decisions, rewards and the outcome in words."""
        rows: list[tuple[float, int, str]] = []
        for step, _, reward in self._batch:
            start_s, end_s = step.first_tick * self._config.timing.dt_s, self._end_s(step)
            for robot, name in enumerate(self._names):
                if step.decided[robot]:
                    direction = DIRECTION_NAMES[int(step.action[robot])]
                    where = tuple(step.before.cells[robot].tolist())
                    rows.append((start_s, step.number, f"{name} in {where} heads for {direction}"))
                if not np.isnan(reward[robot]):
                    where = tuple(step.after.cells[robot].tolist())
                    text = f"{name} ends its move in {where}, reward {reward[robot]:.2f}"
                    rows.append((end_s, step.number, text))
            if step.outcome:
                rows.append((end_s, step.number, f"episode ends: {step.outcome}"))
        if rows:
            time_s, numbers, texts = zip(*sorted(rows), strict=True)
            lines = rr.TextLog.columns(text=texts, level=["INFO"] * len(texts))
            self.file.columns("/log", simulated(np.array(time_s), np.array(numbers)), lines)

    def _starts(self) -> tuple[np.ndarray, np.ndarray]:
        """Times in s and numbers of the batch's RL steps."""
        steps = [decided.step for decided in self._batch]
        times = np.array([step.first_tick for step in steps]) * self._config.timing.dt_s
        return times, np.array([step.number for step in steps])

    def _end_s(self, step: Step) -> float:
        ticks = step.first_tick + self._config.ticks_per_period * len(step.samples.omega)
        return ticks * self._config.timing.dt_s


def _run_document(facts: dict[str, Any], config: CoSimConfig) -> str:
    """Markdown page that says what was run, with every parameter and its source."""
    lines = ["# Episode", "", "| | |", "|---|---|"]
    lines += [f"| {key} | {value} |" for key, value in facts.items()]
    lines += ["", "# Parameters", "", "| name | value | unit | meaning | source |", "|-|-|-|-|-|"]
    lines += [
        f"| {name} | {row['value']} | {row['unit']} | {row['description']} | {row['source']} |"
        for name, row in config.table().items()
    ]
    return "\n".join(lines)

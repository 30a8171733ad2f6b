"""One co-simulated episode as a Rerun recording: the scene once, then every RL step's signals.

Motor speeds and voltages are written at the control period (1 kHz), everything slower at 50 Hz
(velocities and currents as means, contact forces as maxima over 20 ms), and the first 10 ms of
every RL step at every tick.
Colours, units and entity paths are decided here; the layout of views is in `cosim.blueprint`.
"""

from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from cosim.blueprint import episode_blueprint, robot_names
from cosim.config import CoSimConfig
from cosim.episode import Step
from cosim.features import DIRECTION_COUNT, GRADIENT_SIGNS, Observation
from cosim.recording import Recording, properties, simulated
from cosim.scenario import Scenario
from cosim.scene import EIGHT, LIGHT, SERIES, palette, write_scene
from cosim.signals import Samples

# A row costs 35 bytes whatever it holds: only what changes within a motor turn is written faster.
SLOW_PERIOD_S = 0.02
TRAIL_PERIOD_S = 0.5
_FLUSH_STEPS = 4  # RL steps between writes: what a killed process can lose
_METRES_PER_NEWTON = 0.03
DIRECTION_NAMES = tuple(f"{360 * k // DIRECTION_COUNT}°" for k in range(DIRECTION_COUNT))
_ARRIVED = "at target"

# Signals of vector entities: path below /sim/<robot>, names of the components.
_SIM_SERIES = {
    "motors/omega": ("D", "E"),
    "motors/omega_des": ("D", "E"),
    "motors/voltage": ("D", "E"),
    "motors/current": ("D", "E"),
    "motors/theta": ("D", "E"),
    "position": ("x", "y"),
    "heading": ("heading",),
    "velocity": ("x", "y"),
    "heading_error": ("heading error",),
    "contact/normal_max": ("A", "B", "C"),
    "contact/friction_max": ("A", "B", "C"),
    "contact/lifted_share": ("share",),
}
_RAW_SERIES = {
    "omega": ("D", "E"),
    "position": ("x", "y", "z"),
    "normal": ("A", "B", "C"),
    "friction": ("A x", "A y", "B x", "B y", "C x", "C y"),
}


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
        self._return = np.zeros(scenario.robots)
        self._trail: list[np.ndarray] = []
        self.file = Recording(
            path, recording_id, episode_blueprint(scenario.robots, scenario.size_m)
        )
        self.file.stream.send_property("episode", properties(facts))
        write_scene(self.file, scenario, config.robot)
        self._write_styles()
        self.file.static(
            "/info/run", rr.TextDocument(_run_document(facts, config), media_type="text/markdown")
        )

    def __enter__(self) -> "EpisodeRecorder":
        return self

    def __exit__(self, *_: object) -> None:
        self.file.close()

    def write(self, step: Step, q_values: np.ndarray, reward: np.ndarray) -> None:
        """Write one RL step.

        Args:
            step: what the co-simulation returned.
            q_values: (N, 8) action values of the observation before the step.
            reward: (N,) reward of a move completed in the step, NaN where none was.

        Raises:
            RecordingError: the disk is full.
        """
        self.file.check_space()
        dt, period = self._config.timing.dt_s, self._config.timing.control_period_s
        start_s = step.first_tick * dt
        count = len(step.samples.omega)
        time_s = (step.first_tick + self._config.ticks_per_period * np.arange(1, count + 1)) * dt
        raw_time_s = (step.first_tick + np.arange(1, len(step.raw.omega) + 1)) * dt
        every = max(1, round(SLOW_PERIOD_S / period))
        self._trail.extend(step.samples.position[:: round(TRAIL_PERIOD_S / period)])
        for robot, name in enumerate(self._names):
            self._write_signals(name, robot, step.samples, time_s, every)
            for signal in _RAW_SERIES:
                values = getattr(step.raw, signal)[:, robot]
                self.file.scalars(f"/raw/{name}/{signal}", raw_time_s, values)
            self._write_poses(name, robot, step.samples, time_s, every)
            self._write_decision(name, robot, step, q_values[robot], start_s)
            self._write_outcome(name, robot, step, reward[robot], float(time_s[-1]))
        if step.outcome:
            self._log(f"episode ends: {step.outcome}", step.number, float(time_s[-1]))
        if step.number % _FLUSH_STEPS == _FLUSH_STEPS - 1:
            self.file.flush()

    def _write_signals(
        self, name: str, robot: int, samples: Samples, time_s: np.ndarray, every: int
    ) -> None:
        def send(signal: str, values: np.ndarray, times: np.ndarray) -> None:
            self.file.scalars(f"/sim/{name}/{signal}", times, values)

        blocks = len(time_s) // every
        slow = slice(every - 1, blocks * every, every)

        def by_block(signal: str) -> np.ndarray:
            values = getattr(samples, signal)[: blocks * every, robot]
            return values.reshape(blocks, every, *values.shape[1:])

        w, x, y, z = samples.quaternion[slow, robot].T
        heading = np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))
        send("motors/omega", samples.omega[:, robot], time_s)
        send("motors/voltage", samples.voltage[:, robot], time_s)
        send("motors/current", by_block("current").mean(axis=1), time_s[slow])
        send("motors/omega_des", samples.omega_des[slow, robot], time_s[slow])
        send("motors/theta", samples.theta[slow, robot], time_s[slow])
        send("position", samples.position[slow, robot, :2], time_s[slow])
        send("velocity", by_block("velocity")[..., :2].mean(axis=1), time_s[slow])
        send("heading", heading, time_s[slow])
        send("heading_error", samples.heading_error[slow, robot], time_s[slow])
        send("contact/normal_max", by_block("normal_max").max(axis=1), time_s[slow])
        send("contact/friction_max", by_block("friction_max").max(axis=1), time_s[slow])
        send("contact/lifted_share", by_block("lifted_share").mean(axis=1), time_s[slow])

    def _write_poses(
        self, name: str, robot: int, samples: Samples, time_s: np.ndarray, every: int
    ) -> None:
        slow = slice(every - 1, None, every)
        if len(time_s) < every:
            return
        index = simulated(time_s[slow])
        # Rerun wants (x, y, z, w).
        quaternion = np.roll(samples.quaternion[slow, robot], -1, axis=1)
        self.file.columns(
            f"/world/{name}/robot",
            index,
            rr.Transform3D.columns(
                translation=samples.position[slow, robot], quaternion=quaternion
            ),
        )
        normal = samples.normal_max[slow, robot]
        arrows = np.zeros((len(normal), 3, 3))
        arrows[:, :, 2] = _METRES_PER_NEWTON * normal
        columns = rr.Arrows3D.columns(vectors=arrows.reshape(-1, 3))
        self.file.columns(
            f"/world/{name}/robot/contact", index, columns.partition([3] * len(normal))
        )
        trail = np.array(self._trail)[:, robot].copy()
        trail[:, 2] = 0.0005  # on the floor
        self.file.columns(
            f"/world/{name}/trail", simulated(time_s[-1]), rr.LineStrips3D.columns(strips=[trail])
        )

    def _write_decision(
        self, name: str, robot: int, step: Step, q_values: np.ndarray, time_s: float
    ) -> None:
        index = simulated(np.array([time_s]), np.array([step.number]))
        self._write_observation(name, robot, step.before, step.number, time_s)
        action = int(step.action[robot])
        state = DIRECTION_NAMES[action] if action >= 0 else _ARRIVED
        self.file.columns(f"/rl/{name}/action", index, rr.StateChange.columns(state=[state]))
        self._rl(name, "q_s", step.number, time_s, q_values)
        if step.decided[robot]:
            x, y = step.before.cells[robot]
            self._log(f"{name} in cell ({x}, {y}) heads for {state}", step.number, time_s)

    def _write_observation(
        self, name: str, robot: int, observation: Observation, rl_step: int, time_s: float
    ) -> None:
        self._rl(name, "cell", rl_step, time_s, observation.cells[robot])
        if len(self._names) > 1:
            distances = np.linalg.norm(observation.cells - observation.cells[robot], axis=1)
            self._rl(name, "distance", rl_step, time_s, np.delete(distances, robot).min())
        sign = GRADIENT_SIGNS[int(observation.gradient_sign[robot]) + 1]
        index = simulated(np.array([time_s]), np.array([rl_step]))
        self.file.columns(f"/rl/{name}/gradient", index, rr.StateChange.columns(state=[sign]))

    def _write_outcome(
        self, name: str, robot: int, step: Step, reward: float, time_s: float
    ) -> None:
        if step.outcome:
            self._write_observation(name, robot, step.after, step.number, time_s)
        if np.isnan(reward):
            return
        self._return[robot] += reward
        self._rl(name, "reward", step.number, time_s, reward)
        self._rl(name, "return", step.number, time_s, self._return[robot])
        x, y = step.after.cells[robot]
        text = f"{name} ends its move in cell ({x}, {y}), reward {reward:.2f}"
        self._log(text, step.number, time_s)

    def _rl(self, name: str, signal: str, rl_step: int, time_s: float, values: Any) -> None:
        """One row below /rl, on both timelines."""
        row = np.atleast_1d(np.asarray(values, dtype=np.float64))[None]
        times, steps = np.array([time_s]), np.array([rl_step])
        self.file.scalars(f"/rl/{name}/{signal}", times, row, steps)

    def _log(self, text: str, rl_step: int, time_s: float) -> None:
        index = simulated(np.array([time_s]), np.array([rl_step]))
        self.file.columns("/log", index, rr.TextLog.columns(text=[text], level=["INFO"]))

    def _write_styles(self) -> None:
        for name in self._names:
            series = {f"/sim/{name}/{path}": names for path, names in _SIM_SERIES.items()}
            series |= {f"/raw/{name}/{path}": names for path, names in _RAW_SERIES.items()}
            series |= {f"/rl/{name}/{path}": (path,) for path in ("reward", "return", "distance")}
            series[f"/rl/{name}/cell"] = ("x", "y")
            series[f"/rl/{name}/q_s"] = DIRECTION_NAMES
            for entity, names in series.items():
                colours = SERIES if len(names) <= len(SERIES) else EIGHT
                self.file.static(
                    entity,
                    # The default, averaging, would flatten a vibration to nothing.
                    rr.SeriesLines(
                        names=names,
                        colors=palette(colours[: len(names)]),
                        aggregation_policy="MinMax",
                    ),
                )
            self.file.static(
                f"/rl/{name}/action",
                rr.StateConfiguration(
                    values=[*DIRECTION_NAMES, _ARRIVED],
                    labels=[*DIRECTION_NAMES, _ARRIVED],
                    colors=palette([*EIGHT, LIGHT]),
                ),
            )
            self.file.static(
                f"/rl/{name}/gradient",
                rr.StateConfiguration(
                    values=list(GRADIENT_SIGNS),
                    labels=list(GRADIENT_SIGNS),
                    colors=palette(SERIES),
                ),
            )


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

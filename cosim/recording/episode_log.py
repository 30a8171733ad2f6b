"""An episode in words: decisions, moves that end or are given up, contacts, and why it ended."""

from itertools import combinations
from typing import NamedTuple

import numpy as np

from cosim.base.config import CoSimConfig
from cosim.base.scenario import Scenario, touches_obstacle
from cosim.navigation.episode import Step
from cosim.recording.blueprint import robot_names
from cosim.recording.series import DIRECTION_NAMES

# Vibrating robots part and meet many times a second; that is one contact.
NEW_CONTACT_S = 0.5


class Line(NamedTuple):
    """A line of the log: simulated time, RL step, level (INFO, WARN or ERROR) and text."""

    time_s: float
    rl_step: int
    level: str
    text: str


class EpisodeLog:
    """Turns RL steps into lines; remembers what began in earlier steps.

    Args:
        scenario: targets.
        config: clock and geometry.
    """

    def __init__(self, scenario: Scenario, config: CoSimConfig) -> None:
        self._scenario, self._config = scenario, config
        self._names = robot_names(scenario.robots)
        self._walls_m = scenario.walls * scenario.cell_m
        self._under_way = np.zeros(scenario.robots, dtype=bool)
        self._touched_s = dict.fromkeys(combinations(range(scenario.robots), 2), -np.inf)

    def lines(self, step: Step, reward: np.ndarray) -> list[Line]:
        """Lines of an RL step in the order of time.

        Args:
            step: what the co-simulation returned.
            reward: (N,) of the step, NaN for robots that were not on their way.
        """
        timing = self._config.timing
        start_s = step.first_tick * timing.dt_s
        end_s = start_s + len(step.samples.omega) * timing.control_period_s
        lines = [
            Line(start_s, step.number, level, text)
            for robot in np.flatnonzero(step.decided)
            for level, text in self._decision(step, int(robot))
        ]
        lines += self._contacts(step, start_s)
        failed = step.outcome in ("collision", "out_of_board") and ~np.isnan(reward)
        for robot in np.flatnonzero(step.completed | failed):
            where = tuple(step.after.cells[robot].tolist())
            text = f"{self._names[robot]} ends its move in {where}, reward {reward[robot]:.2f}"
            lines.append(Line(end_s, step.number, "INFO", text))
        self._under_way = (step.action >= 0) & ~step.completed
        if step.outcome:
            lines += [Line(end_s, step.number, "WARN", text) for text in self._failures(step)]
            level = "INFO" if step.outcome == "success" else "ERROR"
            lines.append(Line(end_s, step.number, level, f"episode ends: {step.outcome}"))
        return lines

    def _decision(self, step: Step, robot: int) -> list[tuple[str, str]]:
        name, where = self._names[robot], tuple(step.before.cells[robot].tolist())
        text = f"{name} in {where} heads for {DIRECTION_NAMES[int(step.action[robot])]}"
        if not self._under_way[robot]:
            return [("INFO", text)]
        limit_s = self._config.timing.move_limit_s
        return [("WARN", f"{name} gives its move up after {limit_s:g} s"), ("INFO", text)]

    def _contacts(self, step: Step, start_s: float) -> list[Line]:
        """Pairs that begin to touch, and how far apart their centres are."""
        touching, position = step.samples.touching_share > 0.0, step.samples.position[..., :2]
        reach_m = 1.02 * self._config.robot.diameter_m  # of all that touch, those near each other
        lines = []
        for i, j in self._touched_s:
            both = np.flatnonzero(touching[:, i] & touching[:, j])
            for period in both:
                time_s = start_s + (period + 1) * self._config.timing.control_period_s
                distance_m = float(np.linalg.norm(position[period, i] - position[period, j]))
                if distance_m > reach_m:
                    continue
                if time_s - self._touched_s[i, j] > NEW_CONTACT_S:
                    text = (
                        f"{self._names[i]} and {self._names[j]} touch at {time_s:.3f} s: "
                        f"centres {100.0 * distance_m:.2f} cm apart, diameter "
                        f"{100.0 * self._config.robot.diameter_m:.2f} cm"
                    )
                    lines.append(Line(time_s, step.number, "WARN", text))
                self._touched_s[i, j] = time_s
        return sorted(lines)

    def _failures(self, step: Step) -> list[str]:
        """What each robot was short of, unless the episode succeeded."""
        texts = []
        width, height = self._scenario.size_m
        for robot, name in enumerate(self._names):
            x, y = step.samples.position[-1, robot, :2]
            target = self._scenario.targets[robot]
            if step.outcome == "out_of_board" and not (0.0 <= x <= width and 0.0 <= y <= height):
                texts.append(f"{name} leaves the board at ({100.0 * x:.2f}, {100.0 * y:.2f}) cm")
            radius_m = self._config.robot.diameter_m / 2.0
            if touches_obstacle(x, y, radius_m**2, self._walls_m):
                texts.append(f"{name} touches an obstacle at ({100.0 * x:.2f}, {100.0 * y:.2f}) cm")
            if step.outcome == "timeout" and tuple(step.after.cells[robot]) != target:
                way_m = np.hypot(*(np.array(self._scenario.centre_m(target)) - (x, y)))
                texts.append(f"{name} has not arrived: target {100.0 * way_m:.1f} cm away")
        return texts

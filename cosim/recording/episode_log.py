"""An episode as text and states: decisions, moves that end or are given up, and why it ended.

The words are for people. Programs read the states, of entities named in `cosim.recording.series`.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import rerun as rr

from cosim.coupling.rl_step import Step
from cosim.model.config import CoSimConfig
from cosim.model.outcome import COLLISION
from cosim.model.scenario import Scenario, touches_obstacle
from cosim.recording import series
from cosim.recording.file import Kept, simulated

# Vibrating robots part and meet many times a second; that is one contact.
NEW_CONTACT_S = 0.5
# Of all that touch something, those so near each other (over the distance at contact) do.
REACH = 1.02


class Line(NamedTuple):
    """A line of the log, of level INFO, WARN or ERROR; of an entity, its new state."""

    time_s: float
    rl_step: int
    level: str
    text: str
    entity: str = ""
    state: str = ""


class EpisodeLog:
    """Turns RL steps into lines; it remembers what began in earlier ones."""

    def __init__(
        self, scenario: Scenario, config: CoSimConfig, sampled: Sequence[int] | None = None
    ) -> None:
        self._scenario, self._config = scenario, config
        self._sampled = range(scenario.robots) if sampled is None else sampled
        self._names, n = series.robot_names(self._sampled), len(self._sampled)
        self._walls_m = scenario.walls * scenario.cell_m
        self._moving = np.zeros(n, dtype=bool)
        self._touched_s: dict[tuple[int, int], float] = {}  # last time of pairs; of one, a wall

    def lines(self, step: Step, reward: np.ndarray) -> list[Line]:
        """Lines of an RL step in the order of time; `reward` (N,) is NaN where it is unknown."""
        timing = self._config.timing
        start_s = step.first_tick * timing.dt_s
        end_s = start_s + len(step.samples.omega) * timing.control_period_s
        lines = [
            Line(start_s, step.number, *told)
            for robot in np.flatnonzero(step.decided)
            for told in self._decision(step, int(robot))
        ]
        lines += sorted(self._contacts(step, start_s))
        failed = step.outcome in ("collision", "out_of_board") and step.action >= 0
        for robot in np.flatnonzero(step.completed | failed):
            where = tuple(step.after.cells[robot].tolist())
            name = self._names[robot]
            known = not np.isnan(reward[robot])
            text = f"{name} ends its move in {where}" + known * f", reward {reward[robot]:.2f}"
            lines.append(Line(end_s, step.number, "INFO", text, f"/rl/{name}/move", series.ENDED))
        self._moving = (step.action >= 0) & ~step.completed
        if step.outcome:
            for name, state, detail in self._failures(step):
                entity, text = f"/rl/{name}/failure", f"{name} {state}{detail}"
                lines.append(Line(end_s, step.number, "WARN", text, entity, state))
            level = "INFO" if step.outcome == "success" else "ERROR"
            text = f"episode ends: {step.outcome}"
            lines.append(Line(end_s, step.number, level, text, series.OUTCOME, step.outcome))
        return lines

    def _decision(self, step: Step, robot: int) -> list[tuple[str, str, str, str]]:
        """Level, text, entity and state of the lines on a decision."""
        name, where = self._names[robot], tuple(step.before.cells[robot].tolist())
        entity, direction = f"/rl/{name}/move", series.DIRECTION_NAMES[int(step.action[robot])]
        decided = ("INFO", f"{name} in {where} heads for {direction}", entity, direction)
        if not self._moving[robot]:
            return [decided]
        limit_s = self._config.move_limit_s(self._scenario.cell_m)
        text = f"{name} gives its move up after {limit_s:.3g} s"
        return [("WARN", text, entity, series.GIVEN_UP), decided]

    def _contacts(self, step: Step, start_s: float) -> Iterator[Line]:
        """Pairs and robots at obstacles that begin to touch, and where."""
        touching, position = step.samples.touching_share > 0.0, step.samples.position[..., :2]
        diameter_m, names = self._config.robot.diameter_m, self._names
        for period, robot in np.argwhere(touching).tolist():
            time_s = start_s + (period + 1) * self._config.timing.control_period_s
            texts, (x, y) = {}, position[period, robot]
            for other in range(robot):
                distance_m = float(
                    np.linalg.norm(position[period, other] - position[period, robot])
                )
                if touching[period, other] and distance_m <= REACH * diameter_m:
                    texts[other, robot] = (
                        f"{names[other]} and {names[robot]} touch at {time_s:.3f} s: centres "
                        f"{100.0 * distance_m:.2f} cm apart, diameter {100.0 * diameter_m:.2f} cm"
                    )
            if self._at_obstacle(x, y):
                texts[robot, robot] = (
                    f"{names[robot]} touches an obstacle at {time_s:.3f} s: centre at "
                    f"({100.0 * x:.2f}, {100.0 * y:.2f}) cm"
                )
            for pair, text in texts.items():
                if time_s - self._touched_s.get(pair, -np.inf) > NEW_CONTACT_S:
                    yield Line(time_s, step.number, "WARN", text)
                self._touched_s[pair] = time_s

    def _at_obstacle(self, x: float, y: float) -> bool:
        reach_m = REACH * self._config.robot.diameter_m / 2.0
        return bool(touches_obstacle(x, y, reach_m**2, self._walls_m))

    def _failures(self, step: Step) -> Iterator[tuple[str, str, str]]:
        """Robot, state and detail of what each was short of, unless the episode succeeded."""
        width, height = self._scenario.size_m
        for robot, name in enumerate(self._names):
            x, y = step.samples.position[-1, robot, :2]
            target = self._scenario.targets[self._sampled[robot]]
            place = f" at ({100.0 * x:.2f}, {100.0 * y:.2f}) cm"
            if step.outcome == "out_of_board" and not (0.0 <= x <= width and 0.0 <= y <= height):
                yield name, series.OFF_THE_BOARD, place
            touches = step.samples.touching_share[-1, robot] > 0.0
            if step.outcome == "collision" and touches and self._at_obstacle(x, y):
                yield name, series.ON_OBSTACLE, place
            if step.events[robot] == COLLISION and not touches:
                cell = int(x / self._scenario.cell_m), int(y / self._scenario.cell_m)
                on_target = cell in self._scenario.targets
                yield name, series.ON_TARGET if on_target else series.IN_ZONE, place
            if step.outcome == "timeout" and tuple(step.after.cells[robot]) != target:
                away_m = np.hypot(*(np.array(self._scenario.centre_m(target)) - (x, y)))
                yield name, series.NOT_ARRIVED, f": target {100.0 * away_m:.1f} cm away"


def write_lines(file: Kept, lines: list[Line]) -> None:
    """Write lines to `/log`, and the states among them to their entities."""
    by_entity = {"/log": lines} if lines else {}
    for line in lines:
        if line.entity:
            by_entity.setdefault(line.entity, []).append(line)
    for entity, told in by_entity.items():
        times = simulated(np.array([line.time_s for line in told]), [line.rl_step for line in told])
        if entity == "/log":
            texts, levels = [line.text for line in told], [line.level for line in told]
            file.columns(entity, times, rr.TextLog.columns(text=texts, level=levels))
        else:
            file.states(entity, times, [line.state for line in told])


def write_run_page(file: Kept, facts: dict[str, Any], config: CoSimConfig) -> None:
    """Write the page `/info/run`: what was run, with every parameter and its source."""
    lines = ["# Episode", "", "| | |", "|---|---|"]
    lines += [f"| {key} | {value} |" for key, value in facts.items()]
    lines += ["", "# Parameters", "", "| name | value | unit | meaning | source |", "|-|-|-|-|-|"]
    lines += [
        f"| {name} | {row['value']} | {row['unit']} | {row['description']} | {row['source']} |"
        for name, row in config.table().items()
    ]
    page = rr.TextDocument("\n".join(lines), media_type="text/markdown")
    file.static("/info/run", page)

"""Robots on elastic legs: speed and stall force of simulated ones next to published ones.

Motors turn at constant speeds. A robot stalls at the force at its centre of mass, against its
heading, at which it does not move in the mean; its yaw is held meanwhile.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig
from cosim.model.params import Foot, RobotParams, cylinder_inertia, motors_of
from cosim.model.preset import find_preset
from cosim.model.world import tree_of
from cosim.physics.body_state import X, Y, standing_state
from cosim.physics.properties import body_params
from tests.references.prescribed import push, turning

_SETTLE_S, _DRIVE_S, _PIECE_S = 0.4, 1.0, 0.05
_PHASES, _HALVINGS = 4, 9
_CHANGE = 0.2  # of a parameter: its sensitivity is the slope between both ends
_HELD_KG_M2 = 1.0  # of the yaw: as good as fixed


class Legged(NamedTuple):
    """What is published of a robot, ranges, and how its motors turn, assumed."""

    preset: str
    omega_rad_s: tuple[float, ...]
    speed_mm_s: tuple[float, float]
    force_mn: tuple[float, float] | None
    source: str


_RUNS = "repository PaulTiberiu/motor_calibration_pogobot: means of 10 runs of 10 s, twice"
ROBOTS = (
    Legged("hexbug", (1000.0,), (90.0, 154.0), (15.7, 20.0), "papers, partly second hand"),
    Legged("pogobot-brush", (-1150.0, 1150.0), (10.1, 13.1), None, _RUNS),
    Legged("pogobot-rigid", (-975.0, 975.0), (3.35, 3.65), None, _RUNS),
)


def motion(config: CoSimConfig, _: MotorFmu, omega: tuple[float, ...]) -> dict[str, Any]:
    """Speed in m/s, stall force in N and what the speed does where parameters change."""
    found: dict[str, Any] = {"speed": _speed(config, omega), "force": None, "slopes": {}}
    if config.robot.elastic:
        found["force"] = _stall(config, omega)
        for name, changed in PARAMETERS.items():
            ends = [_speed(*changed(config, omega, 1.0 + c)) for c in (-_CHANGE, _CHANGE)]
            span = math.log((1.0 + _CHANGE) / (1.0 - _CHANGE))
            found["slopes"][name] = math.log(ends[1] / ends[0]) / span if min(ends) > 0.0 else None
    return found


def _speed(config: CoSimConfig, omega: tuple[float, ...], pull_n: float = -1.0) -> float:
    """Mean speed in m/s over phases; along its heading, with the yaw held, where it is pulled."""
    robot, dt_s, held = config.robot, config.timing.dt_s, pull_n >= 0.0
    if held:
        i_xx, i_yy, _ = cylinder_inertia(robot)
        robot = robot._replace(inertia_kg_m2=(i_xx, i_yy, _HELD_KG_M2))
    params, speeds = body_params(robot, config.motor, dt_s), []
    piece, pieces = round(_PIECE_S / dt_s), round((_SETTLE_S + _DRIVE_S) / _PIECE_S)
    for phase in range(_PHASES if len(omega) > 1 else 1):
        state, places = standing_state(robot, 0.0, 0.0, 0.0), []
        drive = [(w, k * 2.0 * math.pi * phase / _PHASES) for k, w in enumerate(omega)]
        wrenches = turning(robot, config.motor, drive, piece * pieces, dt_s)
        wrenches[:, 0] -= max(pull_n, 0.0)
        for part in np.split(wrenches, pieces):
            push(state, params, part, np.zeros(5))
            places.append(state[[X, Y]].copy())
        driven = np.diff(places[round(_SETTLE_S / _PIECE_S) - 1 :], axis=0)
        lengths = driven[:, 0] if held else np.hypot(*driven.T)
        speeds.append(lengths.sum() / _DRIVE_S)
    return float(np.mean(speeds))


def _stall(config: CoSimConfig, omega: tuple[float, ...]) -> float:
    """Force in N at which the robot does not move in the mean."""
    low, high = 0.0, 2.0 * config.robot.mu * config.robot.mass_kg * config.motor.g
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _speed(config, omega, middle) > 0.0 else (low, middle)
    return 0.5 * (low + high)


_Case = tuple[CoSimConfig, tuple[float, ...]]


def _with(**changes: Callable[[RobotParams, float], Any]) -> Callable[..., _Case]:
    def changed(config: CoSimConfig, omega: tuple[float, ...], factor: float) -> _Case:
        own = {name: change(config.robot, factor) for name, change in changes.items()}
        return config.merged(tree_of("changed", **own)), omega

    return changed


def _legs(change: Callable[[Any, float], dict[str, float]]) -> Callable[..., _Case]:
    def feet(robot: RobotParams, factor: float) -> tuple[Foot, ...]:
        return tuple(
            foot._replace(leg=foot.leg._replace(**change(foot.leg, factor)))
            for foot in robot.feet
            if foot.leg
        )

    return _with(feet=feet)


def _unbalance(robot: RobotParams, factor: float) -> Any:
    usual = motors_of(robot, find_preset("paper").config().motor)
    return tuple(
        mount._replace(own=(*(o for o in mount.own if o[0] != "r"), ("r", factor * own.r)))
        for mount, own in zip(robot.motors, usual, strict=True)
    )


PARAMETERS: dict[str, Callable[..., _Case]] = {
    "motor speed": lambda config, omega, factor: (config, tuple(factor * w for w in omega)),
    "unbalance": _with(motors=_unbalance),
    "mass": _with(mass_kg=lambda robot, factor: factor * robot.mass_kg),
    "mu": _with(mu=lambda robot, factor: factor * robot.mu),
    "lean": _legs(lambda leg, f: {"lean_deg": f * leg.lean_deg}),
    "stiffness": _legs(
        lambda leg, f: {"axial_n_m": f * leg.axial_n_m, "bending_n_m": f * leg.bending_n_m}
    ),
    "axial stiffness": _legs(lambda leg, f: {"axial_n_m": f * leg.axial_n_m}),
    "damping": _legs(lambda leg, f: {"relaxation_s": f * leg.relaxation_s}),
    "height of the centre": _with(com_height_m=lambda robot, factor: factor * robot.com_height_m),
}


def legged_rows(found: dict[Legged, dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of simulated and published speeds and forces, and of sensitivities of the speed."""
    return [
        {
            "preset": robot.preset,
            "motor_speed_rad_s": abs(robot.omega_rad_s[0]),
            "speed_mm_s": 1e3 * own["speed"],
            "published_mm_s": robot.speed_mm_s,
            "stall_mn": None if own["force"] is None else 1e3 * own["force"],
            "published_mn": robot.force_mn,
            "source": robot.source,
            **{f"d ln v / d ln {name}": slope for name, slope in own["slopes"].items()},
        }
        for robot, own in found.items()
    ]

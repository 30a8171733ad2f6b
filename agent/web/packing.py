"""From a policy and a configuration to the records and tables of a page's episode."""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from agent.deep.inputs import Inputs
from agent.deep.policy import NetworkConfig, NetworkPolicy
from agent.firmware.constants import bearings_by_offset, best_directions, directions
from agent.mdp.greedy import PolicyError
from agent.mdp.readings import FORBIDDEN, FREE, GOAL
from agent.policies import load_policy, method_name
from agent.training.pair_policy import PairPolicy
from agent.training.policy import Policy
from agent.web.layout import MOST_HIDDEN, MOST_ROBOTS, PARTS, SETUP, TABLES
from cosim.coupling.assembly import new_plant
from cosim.model.config import ConfigError, CoSimConfig
from cosim.model.params import SHIELD
from cosim.model.scenario import Scenario
from cosim.model.world import Drawn, motor_phases
from cosim.onboard.camera import (
    DELAY,
    HEADING_VARIANCE,
    INTERVAL,
    POSITION_VARIANCE,
    camera_of,
    frames_in_flight,
    frames_within,
)
from cosim.onboard.features import distance_thresholds
from cosim.physics.properties import body_params, gravity
from cosim.simulation.batch import floor_patches
from cosim.simulation.measures import PATH_SAMPLING_S
from fmus.variables import load_table

PagePolicy = Policy | PairPolicy | NetworkPolicy
_PCG64_FACTOR = 0x2360ED051FC65DA44385DF649FCCF645


class Packed(NamedTuple):
    """Records and tables of a page's episode.

    Attributes:
        setup: float64, see `agent.web.layout.SETUP`.
        tables: by their names in `agent.web.layout.TABLES`.
    """

    setup: np.ndarray
    tables: dict[str, np.ndarray]


def load_page_policy(path: Path, scenario: Scenario) -> PagePolicy:
    """Read a policy that a page can play.

    Raises:
        PolicyError: the file cannot be read, is of another scenario, or of a method that plans.
    """
    policy = load_policy(path, scenario)
    if isinstance(policy, NetworkPolicy) and (width := len(policy.network.b1)) > MOST_HIDDEN:
        raise PolicyError(
            f"{path}: has layers of {width}, but a page plays at most {MOST_HIDDEN}; "
            "train one with `python -m agent.deep`"
        )
    if not isinstance(policy, PagePolicy):
        raise PolicyError(
            f"{path}: is a policy by {method_name(policy)}, but a page plays tables and networks; "
            f"train one with `python -m cosim.run --scenario {scenario.name}`"
        )
    return policy


def finds_any_target(policy: PagePolicy) -> bool:
    """Return whether a page may set a policy's targets."""
    config = policy.config
    return (
        isinstance(config, NetworkConfig)
        and config.any_target
        and config.process.target_obstacle == "cell"
        and not config.scenario.zone_is_obstacle
    )


def require_playable(scenario: Scenario, config: CoSimConfig) -> None:
    """Refuse what a page's episode does not have.

    Raises:
        ConfigError: the configuration has it; the message names the options.
    """
    lacking = {
        "--open-loop": bool(config.open_loop),
        "--reaction": config.reaction,
        "--order jacobi": config.order != "gauss-seidel",
        "--communication-step": config.ticks_per_step != 1,
        "--motor-fmu": bool(config.motor_fmu),
        "--motor-parameter": bool(config.motor_parameters),
    }
    found = [name for name, asked in lacking.items() if asked]
    if found:
        raise ConfigError(f"a page does not support {', '.join(found)}; leave it out")
    if scenario.robots > MOST_ROBOTS:
        raise ConfigError(
            f"scenario {scenario.name} has {scenario.robots} robots, but a page plays at most "
            f"{MOST_ROBOTS}; choose another scenario"
        )


def pack(policy: PagePolicy, scenario: Scenario, config: CoSimConfig) -> Packed:
    """Return what a page needs to play the episodes of `cosim.simulate(..., portable=True)`.

    Args:
        policy: of the robots.
        scenario: with the obstacles of its world.
        config: calibrated.

    Raises:
        ConfigError: see `require_playable`.
    """
    require_playable(scenario, config)
    plant = new_plant(config, scenario.robots, end_on_collision=config.on_collision == "end")
    process, thresholds, timing = policy.process, distance_thresholds(scenario), config.timing
    down = gravity(config.world, Drawn((), 0.0), config.motor.g, portable=True)
    body = body_params(config.robot, config.motor, timing.dt_s, gravity=down, world=config.world)
    contact, ticks = body.contact, config.ticks_per_period
    steering = config.steering._asdict()
    closed, patches = scenario.closed * scenario.cell_m, floor_patches(scenario, config)
    patches[1 : 2 * config.world.edge, 4] = np.nan  # the board itself; the page may change its mu
    facing = math.pi / 2.0 / 2.0  # of robots at their start, halved
    motor = config.motor._asdict() | {"step_size": timing.dt_s}
    parameters = load_table("VibrationMotors").group("parameter")
    values = {
        "robots": scenario.robots,
        "columns": scenario.columns,
        "rows": scenario.rows,
        "cell_m": scenario.cell_m,
        "size": scenario.size_m,
        "targets": np.ravel(scenario.targets),
        "start_counts": [len(cells) for cells in scenario.starts],
        "contact_squared": thresholds.contact,
        "near_squared": thresholds.near,
        "medium_squared": thresholds.medium,
        "strides": process.strides,
        "states": process.state_count,
        "hidden": len(policy.network.b1) if isinstance(policy, NetworkPolicy) else 0,
        "any_target": finds_any_target(policy),
        "walls": len(scenario.walls),
        "control_period_s": ticks * timing.dt_s,
        "ticks_per_period": ticks,
        "decision_periods": config.periods_per_step,
        "move_limit_periods": -(-config.ticks(timing.move_limit_s) // ticks),
        "episode_limit_ticks": config.ticks(timing.episode_limit_s),
        "path_periods": max(1, round(PATH_SAMPLING_S / timing.control_period_s)),
        "through": config.through,
        "ends_on_collision": config.on_collision == "end",
        "noise": config.noise.relative_amplitude,
        "noise_hold_periods": config.periods_per_noise_value,
        "steering": [steering[name] for name in PARTS["steering"]],
        **directions(),
        "shielded": config.shield is not None,
        "shield": config.shield or SHIELD,
        "closed": closed.shape[1],
        "closed_zone": scenario.zone if scenario.zone_is_obstacle else (0, 0, -1, -1),
        "patches": len(patches),
        "spread": config.world.motor_spread or 0.0,
        "motion": [steering[name] for name in PARTS["motion"]],
        "camera": _camera(config),
        "filter": config.estimator,
        "within": np.nextafter(scenario.size_m, 0.0),
        "start_quaternion": (math.cos(facing), math.sin(facing)),
        "com_height_m": config.robot.com_height_m,
        "diameter_m": plant.pair.diameter,
        "mu": config.robot.mu,
        "mu_robots": plant.pair.mu,
        "phases": np.nan_to_num(motor_phases(config.world, scenario.robots)),
        "body": (
            *(body.inverse_mass, *body.inertia, *body.inverse_inertia),
            *(body.product, body.inverse_product, *body.centre, *body.gravity, *contact.mu),
            *(body.restitution, body.dt, body.inverse_dt, *contact.a, *contact.b, *contact.c),
            *(contact.step_normal, contact.step_tangential, contact.spin_inertia),
            contact.tolerance,
        ),
        "mounts": (*plant.mount_d, *plant.mount_e),
        "motor": [motor.get(p.name, p.start or 0.0) for p in parameters],
    }
    assert values.keys() == SETUP.keys()
    setup = np.zeros(sum(field.size for field in SETUP.values()))
    for name, value in values.items():
        setup[SETUP[name].start :][: np.size(value)] = np.ravel(value)
    tables: dict[str, np.ndarray] = {
        "starts": np.array([cell for cells in scenario.starts for cell in cells]),
        "walls": scenario.walls * scenario.cell_m,
        "closed": closed,
        "patches": patches,
        "bearings": bearings_by_offset(process),
    }
    if config.world.draws or config.world.camera.rate_hz:
        tables["widths"] = _normal_widths()
    if isinstance(policy, PairPolicy):
        kept = policy.arrays()
        first = kept.get("first", np.zeros(policy.times.alone.shape, np.uint16))
        tables |= policy.times._asdict() | {"delay": kept["delay"], "first": first}
    elif isinstance(policy, NetworkPolicy):
        tables["network"] = np.concatenate([part.ravel() for part in policy.network])
        terrain = process.terrain
        if finds_any_target(policy):  # the C knows them
            terrain = np.where(np.isin(terrain, (FORBIDDEN, GOAL)), FREE, terrain)
        possible = Inputs.of(scenario, process._replace(terrain=terrain)).possible
        tables["possible"] = np.packbits(possible, axis=-1, bitorder="little")
    else:
        tables["best"] = best_directions(policy.values)
    packed = {
        name: np.ascontiguousarray(tables[name], kind).ravel()
        for name, (_, kind) in TABLES.items()
        if name in tables
    }
    return Packed(setup, packed)


def _camera(config: CoSimConfig) -> tuple[float, ...]:
    sensor = config.world.camera
    camera = camera_of(sensor, config.timing.control_period_s)
    return (
        *camera[[INTERVAL, DELAY]],
        1e-3 * sensor.position_noise_mm,
        math.radians(sensor.heading_noise_deg),
        sensor.dropout,
        *camera[[POSITION_VARIANCE, HEADING_VARIANCE]],
        frames_in_flight(sensor),
        frames_within(sensor, config.timing.rl_step_s),
    )


def _normal_widths() -> np.ndarray:
    """Return the widths over 2^52 by which numpy draws normal numbers, shape (256,).

    numpy multiplies one of them by a part of a random word; that word is made here.
    """
    bits = np.random.PCG64()
    generator, widths = np.random.Generator(bits), np.empty(256)
    for layer in range(256):
        word = (1 << 49) + layer
        # What the generator returns is the lower half of its next state while the upper one is 0.
        before = (word - 1) * pow(_PCG64_FACTOR, -1, 1 << 128) % (1 << 128)
        bits.state = {
            "bit_generator": "PCG64",
            "state": {"state": before, "inc": 1},
            "has_uint32": 0,
            "uinteger": 0,
        }
        widths[layer] = generator.standard_normal() / 2.0**40
    return widths

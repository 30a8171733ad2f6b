"""The page of a policy's episodes: one HTML file that needs no other and no network."""

import base64
import html
import json
import re
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agent.mdp.greedy import GreedyPolicy
from agent.study.policies import policy_of
from agent.training.methods import best_method, find_method
from agent.web.compiler import Module, compiled
from agent.web.image import image_of
from agent.web.playing import Play, deciding, new_play
from cosim.base.arguments import ConfigError
from cosim.base.progress import Progress, silent, under_way
from cosim.base.storage import require_suffix, write_whole
from cosim.fmi.calls import Addresses
from cosim.model.outcome import BY_RANK
from cosim.model.params import feet_names, motor_names
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import ROUGH
from cosim.onboard.features import distance_thresholds
from cosim.onboard.steering import HOLD
from cosim.physics.contact.elastic import axis_of
from cosim.physics.draws import CAMERA_CHILD, DETOUR_CHILD, WORLD_CHILD
from cosim.physics.forces import directions
from cosim.physics.properties import GRAVITY, MU
from cosim.recording.scene import ENLARGED
from cosim.simulation.batch import Batch, world_patches
from cosim.simulation.measures import PATH_SAMPLING_S
from cosim.simulation.options import Setup, SimulationOptions, resolve
from cosim.simulation.rules import USED
from cosim.simulation.simulate import draw_episode

MOST_ROBOTS = 16
MOST_SEED = 2**53 - 1  # the largest whole number that JavaScript keeps
_PARTS = Path(__file__).with_name("page")
_WORKER = ("machine.js", "episode.js", "worker.js")
_SCRIPT = ("board.js", "plot.js", "main.js")
_FRAME_S = 0.025  # of simulated time between two pictures


def write_page(
    out: Path,
    scenario: str | Path | Scenario,
    options: SimulationOptions | None = None,
    *,
    policy: Path | None = None,
    method: str | None = None,
    worlds: Sequence[str] = (),
    seed: int = 0,
    progress: Progress = silent,
) -> int:
    """Write a page (.html) that plays a policy's episodes in a browser; return its size in bytes.

    An episode is that of `cosim.simulate` with its seed.

    Args:
        policy: file of the policy; by default one is made, or found in the cache.
        method: that makes it, by default the scenario's.
        worlds: more of them to choose from: "rough", or files (.toml).
        seed: that the page begins with.

    Raises:
        ConfigError: an option has no effect or cannot be played.
        UserError: the policy has no kernel, or a compiler is missing.
    """
    options, out = options or SimulationOptions(), require_suffix(out, ".html")
    refused = {"--motor-fmu": options.motor_fmu, "--open-loop": options.open_loop}
    if found := [name for name, asked in refused.items() if asked]:
        raise ConfigError(f"a page cannot play {', '.join(found)}; leave it out")
    if policy is not None and method is not None:
        raise ConfigError("--method has no effect on a trained policy; leave one of them out")
    if seed > MOST_SEED:
        raise ConfigError(f"seed = {seed} is more than a browser can count; give at most 2^53 - 1")
    more = [ROUGH if name == "rough" else Path(name) for name in worlds]
    files = {"own": options.world, **{file.stem: file for file in more}}
    if len(files) <= len(worlds):
        raise ConfigError(
            f"worlds {' '.join(worlds)}: two have one name, or one is called own, as the page's "
            "first world is; rename a file"
        )
    board, _ = options.board(scenario, options.world)
    if board.robots > MOST_ROBOTS:
        raise ConfigError(
            f"scenario {board.name} has {board.robots} robots, but a page plays at most "
            f"{MOST_ROBOTS}; choose another scenario"
        )
    for file in files.values():  # before anything is measured
        other, world = options.board(scenario, file)
        options.config(world)  # which refuses what does not fit
        if other != board:
            raise ConfigError(f"{file} has other obstacles; write another page for that world")
    playing = policy_of(
        policy or find_method(method or best_method(board)),
        board,
        options=options,
        progress=progress,
    )
    setups = {name: resolve(options, scenario, progress, world=files[name]) for name in files}
    playing.warn_of_machine(setups["own"].config)
    with under_way(progress, "compiling the episode"):
        data = [_world(name, playing, setup, seed) for name, setup in setups.items()]
    write_whole(out, _html(playing, setups["own"], data, seed))
    return out.stat().st_size


def module_of(scenario: str, method: str) -> Module:
    """Return the compiled kernels of pages of a scenario and method, with default options."""
    setup = resolve(SimulationOptions(), scenario)
    policy = policy_of(method, setup.scenario)
    batch, _, module = _begin(policy, setup, 0)
    batch.close()
    return module


def _begin(policy: GreedyPolicy, setup: Setup, seed: int) -> tuple[Batch, Play, Module]:
    """Return an episode that has begun, as a page plays it, in its batch, and compiled kernels."""
    scenario, config, fmu = setup
    policy.require_scenario(scenario)
    batch = Batch(fmu, config, scenario.robots, 1, lanes=2)
    episode = batch.begin(0, scenario, *draw_episode(scenario, seed, 0))
    decide, decides = deciding(policy)
    play = new_play(batch, episode, decides)
    kernels = {"start": "start", "decide": decide, "step": "step", "place": "place"}
    there = {name: f"agent.web.playing:{kernel}" for name, kernel in kernels.items()}
    return batch, play, compiled(there, play)


def _world(name: str, policy: GreedyPolicy, setup: Setup, seed: int) -> dict[str, Any]:
    """Return a world of a page: kernels, the memory that they begin with, and what is in it."""
    scenario, config, _ = setup
    n, motors, feet = scenario.robots, len(config.robot.motors), len(config.robot.feet)
    batch, play, module = _begin(policy, setup, seed)
    instance = batch.driver.motors.array
    assert instance is not None
    cameras = [CAMERA_CHILD + robot for robot in range(n if config.world.camera.rate_hz else 0)]
    keys = [(0, 0), *((0, 1, k) for k in (WORLD_CHILD, *range(n * motors), *cameras, DETOUR_CHILD))]
    nowhere = play.calls._replace(
        instances=np.zeros_like(play.calls.instances), functions=Addresses(0, 0, 0)
    )
    image = image_of(
        play._replace(calls=nowhere),  # without addresses of this process
        motors=np.frombuffer(instance.get_state(), dtype=np.uint8),
        generators=np.zeros((len(keys), 4), dtype=np.uint64),
        keys=np.zeros(3, dtype=np.uint32),
        chance=np.zeros(n),
    )
    batch.close()
    properties, rows = play.state.bodies.properties, slice(MU, MU + 2 * feet)
    places = np.arange(properties.size).reshape(properties.shape)[rows, :n]
    equal = (properties[rows, :n] == config.robot.mu).all()
    facts = {
        "starts": scenario.starts,
        "contact": distance_thresholds(scenario).contact,
        "keys": keys,
        "hold": play.hold,
        "used": USED,
        "hold_mode": HOLD,
        "gravity": GRAVITY,
        "friction": places.ravel().tolist() if equal else [],
        "ticks": config.ticks_per_period,
        "periods": play.periods,
        "dt_s": config.timing.dt_s,
        "frame_periods": max(1, round(_FRAME_S / config.timing.control_period_s)),
        "path_periods": max(1, round(PATH_SAMPLING_S / config.timing.control_period_s)),
        "motors": motors,
        "feet": feet,
        "patches": world_patches(scenario, config.world),
        "edge": config.world.edge,
        "mu": config.robot.mu,
        "noise": config.noise.relative_amplitude,
        "shielded": config.shield is not None,
    }
    packed = {"wasm": _packed(module.content), "image": _packed(image.content)}
    return {"name": name, **packed, "layout": image.layout, "facts": facts}


def _html(policy: GreedyPolicy, setup: Setup, worlds: list[dict[str, Any]], seed: int) -> str:
    scenario, robot, cell_m = setup.scenario, setup.config.robot, setup.scenario.cell_m
    motors = [(mount.place_m[:2], *directions(mount.axis)) for mount in robot.motors]
    soles = [(foot.x_m, foot.y_m) for foot in robot.feet]
    data = {
        "scenario": {
            "columns": scenario.columns,
            "rows": scenario.rows,
            "cell_m": cell_m,
            "diameter_m": scenario.diameter_m,
            "zone": scenario.zone,
            "targets": scenario.targets,
            "walls": (scenario.walls * cell_m).tolist(),
            "maps": _maps(policy),
        },
        "machine": {
            "motors": [(n, *m) for n, m in zip(motor_names(len(motors)), motors, strict=True)],
            "feet": list(zip(feet_names(len(soles)), soles, strict=True)),
            # From tip to root of each elastic leg, seen from above
            "legs": [
                [-foot.leg.length_m * part for part in axis_of(foot.leg)[:2]]
                for foot in robot.feet
                if foot.leg
            ],
            "enlarged": ENLARGED,
        },
        "seed": seed,
        "outcomes": [str(outcome).replace("_", " ") or "running" for outcome in BY_RANK],
        "step_s": setup.config.timing.rl_step_s,
        "worlds": worlds,
    }
    one = scenario.robots == 1
    wide, high = (f"{100.0 * length:.3g}" for length in scenario.size_m)
    parts = {
        "title": html.escape(f"Scenario {scenario.name}: {scenario.title}"),
        "seen": (
            f"{'One robot' if one else f'{scenario.robots} robots'} of "
            f"{100.0 * scenario.diameter_m:.2g} cm drive{'s' * one} across a board of {wide} × "
            f"{high} cm to {'its target' if one else 'their targets'}, moved by nothing but the "
            f"vibration of {len(motors)} motors in each robot."
        ),
        "about": (
            f"The policy is by the method {html.escape(policy.config.method)}. An episode is that "
            "of <code>minirobots run</code> with its seed and the options of this page, in every "
            "bit: the same code, compiled to WebAssembly. With less friction robots slide further "
            "in every turn of their motors, whose speeds are those for the friction of the world, "
            "and drive faster; with more of it they are slower."
        ),
        "style": _text("style.css"),
        "worker": "\n".join(map(_text, _WORKER)),
        "script": "\n".join(map(_text, _SCRIPT)),
        # What looks like a tag would end the script element.
        "data": json.dumps(data, separators=(",", ":")).replace("<", "\\u003c"),
    }
    return re.sub(r"\{(\w+)\}", lambda name: parts[name[1]], _text("page.html"))


def _text(name: str) -> str:
    return (_PARTS / name).read_text(encoding="utf-8")


def _packed(content: bytes) -> str:
    return base64.b64encode(zlib.compress(content, 9)).decode()


def _maps(policy: GreedyPolicy) -> list[dict[str, Any]]:
    """Value and best direction of every cell by robot; None where nothing is known."""
    return [
        {
            "value": [
                round(float(value), 3) if visits else None
                for value, visits in zip(m.value.flat, m.visits.flat, strict=True)
            ],
            "action": m.action.ravel().tolist(),
        }
        for m in policy.maps()
    ]

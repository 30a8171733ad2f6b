"""The page of a policy's episodes: one HTML file that needs no other and no network."""

import base64
import html
import json
import re
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agent.mdp.greedy import GreedyPolicy
from agent.training.methods import best_method, find_method, method_config
from agent.training.policy import load_policy
from agent.training.store import find_or_make
from agent.web.playable import Playable, playable
from cosim.base.arguments import ConfigError
from cosim.base.progress import Progress, silent, under_way
from cosim.base.storage import require_suffix, write_whole
from cosim.model.config import CoSimConfig
from cosim.model.outcome import BY_RANK
from cosim.model.params import feet_names, motor_names, mounts_of
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import ROUGH, find_in_world
from cosim.onboard.features import distance_thresholds
from cosim.onboard.steering import HOLD
from cosim.physics.contact import feet_of
from cosim.physics.draws import CAMERA_CHILD, DETOUR_CHILD, WORLD_CHILD
from cosim.physics.properties import GRAVITY, MU
from cosim.simulation.batch import floor_patches
from cosim.simulation.measures import PATH_SAMPLING_S
from cosim.simulation.options import Setup, SimulationOptions, resolve
from cosim.simulation.rules import USED

MOST_ROBOTS = 16
MOST_SEED = 2**53 - 1  # the largest whole number that JavaScript keeps
_PARTS = Path(__file__).with_name("page")
_WORKER = ("machine.js", "episode.js", "worker.js")
_SCRIPT = ("board.js", "plot.js", "main.js")
_FRAME_S = 0.025  # of simulated time between two pictures


def require_playable(scenario: Scenario, config: CoSimConfig) -> None:
    """Refuse what a page's episode does not have.

    Raises:
        ConfigError: the configuration has it; the message names the options.
    """
    lacking = {"--motor-fmu": config.motor_fmu, "--open-loop": config.open_loop}
    if found := [name for name, asked in lacking.items() if asked]:
        raise ConfigError(f"a page cannot play {', '.join(found)}; leave it out")
    if scenario.robots > MOST_ROBOTS:
        raise ConfigError(
            f"scenario {scenario.name} has {scenario.robots} robots, but a page plays at most "
            f"{MOST_ROBOTS}; choose another scenario"
        )


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
        ConfigError: an option cannot be played.
        UserError: the policy has no kernel, or a compiler is missing.
    """
    options, out = options or SimulationOptions(), require_suffix(out, ".html")
    if seed > MOST_SEED:
        raise ConfigError(f"seed = {seed} is more than a browser can count; give at most 2^53 - 1")
    files = {"own": options.world} | {
        Path(name).stem: ROUGH if name == "rough" else Path(name) for name in worlds
    }
    if len(files) <= len(worlds):
        raise ConfigError(
            f"worlds {' '.join(worlds)}: two have one name, or one is called own, as the page's "
            "first world is; rename a file"
        )
    boards = [find_in_world(scenario, file) for file in files.values()]
    for (board, world), file in zip(boards, files.values(), strict=True):
        require_playable(board, options.config(world))  # before anything is measured
        if board != boards[0][0]:
            raise ConfigError(f"{file} has other obstacles; write another page for that world")
    playing = _policy(options.board(boards[0][0]), options, policy, method, progress)
    setups = {
        name: resolve(options, scenario, progress, world=file) for name, file in files.items()
    }
    with under_way(progress, "compiling the episode"):
        found = {name: playable(playing, setup, seed) for name, setup in setups.items()}
    write_whole(out, _html(playing, setups, found, seed))
    return out.stat().st_size


def _policy(
    scenario: Scenario,
    options: SimulationOptions,
    policy: Path | None,
    method: str | None,
    progress: Progress,
) -> GreedyPolicy:
    if policy is not None:
        return load_policy(policy, scenario)
    chosen = find_method(method or best_method(scenario))
    motors = options.motor_parameters if chosen.through else ()
    how = {"motor_parameters": motors, "preset": options.preset, "progress": progress}
    return find_or_make(method_config(chosen, scenario, **how), progress=progress)[0]


def _html(
    policy: GreedyPolicy, setups: Mapping[str, Setup], found: Mapping[str, Playable], seed: int
) -> str:
    scenario, config, _ = next(iter(setups.values()))
    mounts, feet = mounts_of(config.robot), feet_names(config.robot.feet_count)
    data = {
        "scenario": {
            "columns": scenario.columns,
            "rows": scenario.rows,
            "cell_m": scenario.cell_m,
            "diameter_m": scenario.diameter_m,
            "zone": scenario.zone,
            "targets": scenario.targets,
            "walls": (scenario.walls * scenario.cell_m).tolist(),
            "maps": _maps(policy),
        },
        "machine": {
            "motors": [
                {"name": name, "x": mount.place_m[0], "y": mount.place_m[1]}
                for name, mount in zip(motor_names(len(mounts)), mounts, strict=True)
            ],
            "feet": [
                {"name": name, "x": foot.x_m, "y": foot.y_m}
                for name, foot in zip(feet, feet_of(config.robot), strict=True)
            ],
        },
        "seed": seed,
        "outcomes": [str(outcome).replace("_", " ") or "running" for outcome in BY_RANK],
        "step_s": config.timing.rl_step_s,
        "worlds": [
            {
                "name": name,
                "wasm": _kept(found[name].wasm),
                "image": _kept(found[name].image.content),
                "layout": found[name].image.layout,
                "facts": _facts(setup, found[name]),
            }
            for name, setup in setups.items()
        ],
    }
    about = (
        f"The policy is by the method {policy.config.method}. An episode is that of "
        "<code>minirobots run</code> with its seed and the options of this page, in every bit: the "
        "same code, compiled to WebAssembly."
    )
    parts = {
        "title": html.escape(f"Scenario {scenario.name}: {scenario.title}"),
        "seen": _seen(scenario, len(mounts)),
        "about": about,
        "style": _text("style.css"),
        "worker": "\n".join(map(_text, _WORKER)),
        "script": "\n".join(map(_text, _SCRIPT)),
        # What looks like a tag would end the script element.
        "data": json.dumps(data, separators=(",", ":")).replace("<", "\\u003c"),
    }
    return re.sub(r"\{(\w+)\}", lambda name: parts[name[1]], _text("page.html"))


def _seen(scenario: Scenario, motors: int) -> str:
    """Return one sentence about what is seen."""
    who = "One robot" if scenario.robots == 1 else f"{scenario.robots} robots"
    whose, verb = ("its target", "drives") if scenario.robots == 1 else ("their targets", "drive")
    wide, high = (f"{100.0 * length:.3g}" for length in scenario.size_m)
    return (
        f"{who} of {100.0 * scenario.diameter_m:.2g} cm {verb} across a board of {wide} × {high} "
        f"cm to {whose}, moved by nothing but the vibration of {motors} motors in each robot."
    )


def _facts(setup: Setup, found: Playable) -> dict[str, Any]:
    """Return what JavaScript needs to know of the episode's arrays."""
    scenario, config, _ = setup
    period_s, n, camera = config.timing.control_period_s, scenario.robots, config.world.camera
    properties = found.page.play.state.properties
    rows = slice(MU, MU + 2 * config.robot.feet_count)
    own = properties[rows, :n] == config.robot.mu
    places = np.arange(properties.size).reshape(properties.shape)[rows, :n]
    children = [*range(n * config.robot.motors_count)]
    children += [CAMERA_CHILD + robot for robot in range(n) if camera.rate_hz]
    return {
        "starts": scenario.starts,
        "contact": distance_thresholds(scenario).contact,
        "generators": [
            (0, 0),
            *((0, 1, child) for child in [WORLD_CHILD, *children, DETOUR_CHILD]),
        ],
        "hold": found.page.play.hold,
        "used": USED,
        "hold_mode": HOLD,
        "gravity": GRAVITY,
        "friction": places.ravel().tolist() if own.all() else [],
        "ticks": config.ticks_per_period,
        "dt_s": config.timing.dt_s,
        "frame_periods": max(1, round(_FRAME_S / period_s)),
        "path_periods": max(1, round(PATH_SAMPLING_S / period_s)),
        "motors": config.robot.motors_count,
        "feet": config.robot.feet_count,
        "patches": floor_patches(scenario, config)[2 * config.world.edge :].tolist(),
        "edge": config.world.edge,
        "mu": config.robot.mu,
        "noise": config.noise.relative_amplitude,
        "shielded": config.shield is not None,
    }


def _text(name: str) -> str:
    return (_PARTS / name).read_text(encoding="utf-8")


def _kept(content: bytes) -> str:
    """Deflated, as text."""
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

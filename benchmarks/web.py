"""Measure how fast a page computes in Chromium, next to the kernels of this machine.

Robots of a policy drive the same simulated seconds in turn: in the page's worker, and in the
co-simulation of this process with one body at a time (scalar) and two in a vector (the default).
The best round of each counts.
"""

import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

import agent
from agent.web.build import cached_wasm
from agent.web.page import write_page
from cosim.base.errors import UserError
from cosim.coupling.rl_step import decide
from cosim.simulation.cosimulation import CoSimulation
from cosim.simulation.options import SimulationOptions, resolve
from cosim.simulation.simulate import draw_episode
from minirobots.options import CommandOptions, Count, ScenarioName, Seconds

CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
LOADED = "!document.getElementById('play').disabled"


class Options(CommandOptions):
    scenario: ScenarioName = "4"
    rounds: Count = 3
    """Rounds of each; the best counts."""
    round_s: Seconds = 40.0
    """Simulated time of a round in s, less than the episode takes."""


def measure(options: Options) -> dict[str, Any]:
    if not (program := next(filter(None, map(shutil.which, CHROMIUM)), None)):
        raise UserError(f"no browser found; install one of {', '.join(CHROMIUM)}")
    policy = agent.train(options.scenario)
    physics = SimulationOptions(time_limit=options.round_s)
    board, config, fmu = resolve(physics, policy.config.scenario)
    starts, seed = draw_episode(board, 0, 0)
    systems = {
        f"kernels, {n} in a vector": CoSimulation(board, fmu, config, lanes=n) for n in (1, 2)
    }
    for system in systems.values():
        system.compile()
    factors: dict[str, list[float]] = {name: [] for name in ("page", *systems)}
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        path = Path(folder) / "page.html"
        write_page(path, policy, board, config, cached_wasm())
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        page = browser.new_page()
        version = browser.version
        page.goto(path.as_uri())
        page.wait_for_function(LOADED)
        for _ in range(options.rounds):
            found = page.evaluate(
                "recordEpisode({seed: 0}).then(({time_s, wall_s}) => time_s / wall_s)"
            )
            factors["page"].append(found)
            for name, system in systems.items():
                observation = system.reset(starts, seed)
                began = time.perf_counter()
                while not system.outcome:
                    observation = system.advance(decide(policy, observation).action).after
                factors[name].append(system.time_s / (time.perf_counter() - began))
        browser.close()
    best = {name: max(values) for name, values in factors.items()}
    shares = {name: best["page"] / best[name] for name in systems}
    return {"chromium": version, "real_time_factor": best, "page_over": shares}

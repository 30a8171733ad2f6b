"""The page in a browser and in Node.js: its bits, and what people see and do."""

import json
import math
import shutil
import subprocess
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from playwright.sync_api import sync_playwright

import cosim
from agent.training.policy import load_policy
from agent.web.page import write_page
from cosim.base.errors import UserError
from cosim.coupling.rl_step import decide
from cosim.model.outcome import Outcome
from cosim.model.scenario import Scenario
from cosim.simulation.batch import Batch
from cosim.simulation.options import Setup, SimulationOptions, resolve
from cosim.simulation.simulate import draw_episode

PLAY = Path(__file__).with_name("play.js")
LOADED = "!document.getElementById('play').disabled || window.pageError"
TIME = "document.getElementById('time').textContent"
HOSTILE = "</script><script>window.hacked = true</script>{data}"
NEAR = Scenario("near", "one robot", targets=((15, 15),), starts=(((15, 18), (15, 12)),))
SLOPE = {
    "floor_tilt_deg": 1.0,
    "edge": True,
    "restitution": 0.2,
    "mu_patches": [{"cells": [10, 8, 20, 13], "mu": 0.3}],
}
ROUGH = "rough.toml"


class Case(NamedTuple):
    """What is played, by a policy of a method."""

    scenario: str | Scenario
    method: str
    options: dict[str, Any] = {}
    world: dict[str, Any] | None = None


CASES = {
    "pair": Case("4", "shortest"),
    "rough": Case("4", "moves", {"shield": True, "world": "rough"}),
    "slope": Case("2", "shortest", {}, SLOPE),
    "group": Case("4-cross", "planned", {"through": True}),
    "droplet": Case("2", "shortest", {"preset": "droplet"}),
    "reaction": Case("2", "shortest", {"reaction": True}),
}

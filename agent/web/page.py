"""The page of an episode: one HTML file that needs no other and no network."""

import base64
import html
import json
import re
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agent.web.layout import SETUP, TABLES, VIEW
from agent.web.packing import PagePolicy, finds_any_target, pack
from cosim.base.storage import write_whole
from cosim.model.config import CoSimConfig
from cosim.model.scenario import Scenario
from cosim.simulation.batch import floor_patches

PARTS = Path(__file__).with_name("page")
OF_WORLDS = ("patches", "widths")  # tables in which worlds differ
_EMPTY = np.empty(0)
SCRIPTS = ("board.js", "plot.js", "main.js")


def render_page(
    policy: PagePolicy,
    scenario: Scenario,
    config: CoSimConfig,
    wasm: bytes,
    seed: int = 0,
    about: str = "",
    worlds: Mapping[str, CoSimConfig] | None = None,
) -> str:
    """Return the HTML of a page that plays a policy's episodes.

    Args:
        policy: of the robots.
        scenario: with the obstacles of its world.
        config: calibrated, see `agent.web.packing.require_playable`.
        wasm: module of `agent.web.build`.
        seed: that the page begins with.
        about: how the page was made, for people.
        worlds: configurations by name that one can choose in the page, with the same obstacles;
            `config` comes first, as `own`.
    """
    configs = {"own": config, **(worlds or {})}
    packed = {name: pack(policy, scenario, each) for name, each in configs.items()}
    tables = packed["own"].tables
    data: dict[str, Any] = {
        "scenario": {
            "columns": scenario.columns,
            "rows": scenario.rows,
            "cell_m": scenario.cell_m,
            "diameter_m": scenario.robot_diameter_m,
            "zone": scenario.zone,
            "targets": scenario.targets,
            "walls": (scenario.walls * scenario.cell_m).tolist(),
            "maps": _maps(policy),
            "any_target": finds_any_target(policy),
        },
        "layout": {"setup": SETUP, "view": VIEW},
        "seed": seed,
        "worlds": [
            {
                "name": name,
                "mu": each.robot.mu,
                "noise": each.noise.relative_amplitude,
                "shielded": each.shield is not None,
                "patches": floor_patches(scenario, each)[2 * each.world.edge :].tolist(),
                "setup": _kept(parts.setup.tobytes()),
                "tables": [_kept(parts.tables.get(table, _EMPTY).tobytes()) for table in OF_WORLDS],
            }
            for (name, each), parts in zip(configs.items(), packed.values(), strict=True)
        ],
        "of_worlds": [list(TABLES).index(table) for table in OF_WORLDS],
        "tables": [
            _kept_sparse(tables[name])
            if name == "delay" and name in tables
            else _kept(tables.get(name, _EMPTY).tobytes() if name not in OF_WORLDS else b"")
            for name in TABLES
        ],
        "wasm": _kept(wasm),
    }
    parts = {
        "title": html.escape(f"Scenario {scenario.name}"),
        "subtitle": html.escape(scenario.title),
        "about": html.escape(about),
        "style": (PARTS / "style.css").read_text(encoding="utf-8"),
        "worker": (PARTS / "worker.js").read_text(encoding="utf-8"),
        "script": "\n".join((PARTS / name).read_text(encoding="utf-8") for name in SCRIPTS),
        # What looks like a tag would end the script element.
        "data": json.dumps(data, separators=(",", ":")).replace("<", "\\u003c"),
    }
    page = (PARTS / "page.html").read_text(encoding="utf-8")
    return re.sub(r"\{(\w+)\}", lambda name: parts[name[1]], page)


def write_page(path: Path, *arguments: Any, **options: Any) -> None:
    """Write the page of `render_page`, whole or not at all."""
    write_whole(path, render_page(*arguments, **options))


def _kept(content: bytes) -> str:
    """Deflated, as text."""
    return base64.b64encode(zlib.compress(content, 9)).decode()


def _kept_sparse(table: np.ndarray) -> list[str]:
    """Return which of many uint16 are not 0, a bit each, and the lower and upper bytes of those.

    Learnt delays take a third less so than as they are.
    """
    mask = table != 0
    halves = table[mask].view(np.uint8).reshape(-1, 2).T
    return [_kept(np.packbits(mask).tobytes()), _kept(halves.tobytes())]


def _maps(policy: PagePolicy) -> list[dict[str, Any]]:
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

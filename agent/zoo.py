"""Policies of the built-in scenarios by name, such as zoo:4-pair, and what they achieve.

A policy of the zoo is that of a method with seed 0. It is trained or computed where it is first
used, which takes seconds to minutes, and found in the cache afterwards, under the hash of
everything that decides its bits.
"""

from pathlib import Path
from typing import Any

import msgspec

from agent.method import best_method, method_config, method_policy
from agent.training.group_policy import GroupPolicy, can_plan
from agent.training.pair_policy import PairPolicy
from agent.training.policy import Policy
from agent.training.settings import Method
from agent.training.store import config_digest
from cosim.base.arguments import ConfigError
from cosim.base.progress import Progress, silent
from cosim.base.reading import Kind, read_json
from cosim.model.built_in import BUILT_IN, PAPER
from cosim.model.scenario import Scenario

PREFIX = "zoo:"
_PUBLISHED = Path(__file__).with_name("leaderboard.json")
_FILE = Kind("leaderboard", "make it with `minirobots policies --measure`", ConfigError)


class Entry(msgspec.Struct, frozen=True, kw_only=True):
    """Results of a policy of the leaderboard in the dynamics.

    Attributes:
        scenario: its name.
        policy: its name, such as zoo:4-pair, or what a user named.
        made: hash of the configuration that a policy of the zoo was made with.
        episodes, success, success_low, success_high, sim_time_s, path_length_cm: see
            `agent.evaluation.outcomes.Measured`.
    """

    scenario: str
    policy: str
    made: str | None
    episodes: int
    success: float | None
    success_low: float | None
    success_high: float | None
    sim_time_s: float | None
    path_length_cm: float | None


def zoo() -> dict[str, tuple[Scenario, Method]]:
    """Return scenario and method of each policy of the zoo, by name."""
    found: dict[str, tuple[Scenario, Method]] = {}
    for board in BUILT_IN.values():
        if board.robots > 2 and not can_plan(board):
            continue  # a swarm has no policy of its own
        methods: list[Method] = [best_method(board), "moves" if board.robots > 2 else "fastest"]
        if board.name in PAPER:
            methods.extend(("moves", "paper", "shortest"))
        found |= {f"{PREFIX}{board.name}-{m}": (board, m) for m in dict.fromkeys(methods)}
    return found


def _known(name: str) -> tuple[Scenario, Method]:
    known = zoo()
    if name not in known:
        raise ConfigError(f"policy {name} is not in the zoo; choose one of {', '.join(known)}")
    return known[name]


def zoo_policy(name: str, progress: Progress = silent) -> Policy | PairPolicy | GroupPolicy:
    """Return a policy of the zoo: found in the cache, or trained or computed and kept there.

    Raises:
        ConfigError: no policy of the zoo has this name.
    """
    board, method = _known(name)
    return method_policy(method, board, progress=progress)[0]


def made_with(name: str) -> str:
    """Return the hash (16 hex digits) of the configuration of a policy of the zoo."""
    board, method = _known(name)
    return config_digest(method_config(method, board))


def published(path: Path = _PUBLISHED) -> list[Entry]:
    """Return the rows of a leaderboard; by default of the published one.

    Raises:
        ConfigError: the file is missing or damaged.
    """
    return read_json(path, _FILE, list[Entry])


def zoo_rows(scenarios: tuple[str, ...] = ()) -> list[dict[str, Any]]:
    """Return a row for each policy of the zoo: what it is, and what it was measured to achieve.

    Args:
        scenarios: by default all.
    """
    entries, rows = {entry.policy: entry for entry in published()}, []
    for name, (board, method) in zoo().items():
        if scenarios and board.name not in scenarios:
            continue
        entry = entries.get(name)
        found = msgspec.structs.asdict(entry) if entry else {"policy": name}
        now = entry is not None and entry.made == made_with(name)
        rows.append({"scenario": board.name, "method": method, "current": now} | found)
    return rows

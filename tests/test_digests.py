"""Bits that a restructuring must not change: policies, moves, episodes and recordings, as hashes.

The expected hashes stand in `digests.json` beside this file. They hold on x86-64 processors with
FMA (any of the last ten years): nothing here passes through a linear-algebra library, whose kernels
differ. Where bits are meant to change, say so in CHANGELOG and write the file anew with
`DIGESTS=write uv run --group test pytest tests/test_digests.py`.
"""

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from agent.moves.observe import observe_moves
from agent.process.config import ProcessConfig
from agent.training.policy import Policy, PolicyConfig, Seed
from agent.training.settings import LearningConfig
from agent.training.store import train_policy
from cosim.base.config import CoSimConfig
from cosim.episodes import Task, simulate_tasks
from cosim.navigation.episode import RunningEpisode
from cosim.navigation.observing import draw_starts
from cosim.reading.episode import read_episode
from cosim.recording.episode import EpisodeRecorder
from cosim.scenarios.file import find_scenario
from fmus.build import cached_fmu

EXPECTED = Path(__file__).with_name("digests.json")
LEARNERS = {
    "1a": ("1a", LearningConfig(episodes=4000)),
    "2": ("2", LearningConfig(episodes=4000)),
    "4": ("4", LearningConfig(episodes=4000)),
    "4 double Q": ("4", LearningConfig(episodes=4000, algorithm="double_q")),
}


def _digest(*parts: Any) -> str:
    """Hash (16 hex digits) of arrays and of what JSON can hold."""
    found = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            found.update(
                f"{part.dtype}{part.shape}".encode() + np.ascontiguousarray(part).tobytes()
            )
        else:
            found.update(json.dumps(part, sort_keys=True).encode())
    return found.hexdigest()[:16]


def _of_policy(policy: Policy) -> str:
    return _digest(policy.q, policy.visits, policy.random, policy.episodes)


@pytest.fixture(scope="module")
def digests(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Hash of each result, made here and now."""
    found: dict[str, str] = {}
    for name, (scenario, learning) in LEARNERS.items():
        config = PolicyConfig(find_scenario(scenario), ProcessConfig(), learning, Seed(0))
        found[f"policy {name}"] = _of_policy(train_policy(config)[0])
    config, fmu = CoSimConfig(), cached_fmu()
    moves = observe_moves(config, fmu, moves_per_kind=2, seed=0)
    found["moves"] = _digest([[getattr(m, f) for f in m.__struct_fields__] for m in moves.moves])
    scenario = find_scenario("4")
    features = ProcessConfig(features=("x", "y", "d", "g", "b"), step_limit=200)
    learner = PolicyConfig(scenario, features, LearningConfig(episodes=4000), Seed(0), moves)
    policy = train_policy(learner)[0]
    found["policy 4 moves"] = _of_policy(policy)

    path = tmp_path_factory.mktemp("digests") / "episode.rrd"
    config = CoSimConfig(timing=config.timing._replace(episode_limit_s=6.0, burst_s=0.01))
    start_seed, noise_seed = np.random.SeedSequence(0).spawn(2)
    starts = draw_starts(scenario, np.random.default_rng(start_seed))

    def recorder(_: RunningEpisode) -> EpisodeRecorder:
        return EpisodeRecorder(path, scenario, config, "digest", {"episode": 0})

    task = Task(scenario, fmu, config, policy, starts, noise_seed, recorder)
    ((_, result),) = simulate_tasks([task], 1)
    fields = msgspec.structs.asdict(result)
    # the ideal world draws nothing and has no shield
    del fields["realtime_factor"], fields["drawn"], fields["shield_stops"]
    found["episode"] = _digest(fields)
    for name, signal in sorted(read_episode(path).signals.items()):
        found[f"signal {name}"] = _digest(signal.time_s, signal.values)
    if os.environ.get("DIGESTS") == "write":
        EXPECTED.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    return found


def test_bits_are_those_committed(digests):
    assert digests == json.loads(EXPECTED.read_text("utf-8"))

"""Trained once, found again; the paper's scenario 2 on its full budget."""

import msgspec
import numpy as np
import pytest

from agent.mdp.config import ProcessConfig
from agent.mdp.exact import evaluate
from agent.training.policy import PolicyConfig, Seed
from agent.training.settings import LearningConfig
from agent.training.store import LOG_FILE, find_or_make
from cosim.model.outcome import Outcome
from cosim.model.scenario_file import find_scenario

pytestmark = pytest.mark.usefixtures("fresh_cache")

SHORT = LearningConfig(episodes=5000, epsilon_episodes=10, greedy_points=5)
CONFIG = PolicyConfig(find_scenario("2"), ProcessConfig(), SHORT, Seed(0))


def test_a_second_call_finds_the_policy_and_its_curves():
    seen = []
    policy, log, path = find_or_make(CONFIG, progress=lambda *now, **_: seen.append(now))
    assert [now[1] for now in seen] == [1000, 2000, 3000, 4000, 5000]
    seen.clear()
    again, log_again, path_again = find_or_make(CONFIG, progress=lambda *now, **_: seen.append(now))
    assert not seen
    assert path == path_again
    assert np.array_equal(policy.q, again.q)
    for name in log._fields:
        assert np.array_equal(getattr(log, name), getattr(log_again, name), equal_nan=True)
    assert log.episode.tolist() == log.greedy_episode.tolist() == [1000, 2000, 3000, 4000, 5000]
    assert log.returns.shape == (5, 2)
    assert log.epsilon[[0, -1]] == pytest.approx([0.9 * 0.999**99, 0.0])
    assert log.greedy_success[-1] == evaluate(policy.process, policy.values).rate(Outcome.SUCCESS)


@pytest.mark.long
@pytest.mark.parametrize(
    "other",
    [
        {"seed": Seed(1)},
        {"scenario": find_scenario("3")},
        {"process": ProcessConfig(approach_coefficient=2.0)},
        {"learning": LearningConfig(episodes=5001, epsilon_episodes=10)},
        {},
    ],
)
def test_any_difference_trains_again(other):
    find_or_make(CONFIG)
    seen = []
    find_or_make(
        msgspec.structs.replace(CONFIG, **other),
        again=not other,
        progress=lambda *now, **_: seen.append(now),
    )
    assert seen


@pytest.mark.parametrize("broken", ["policy.npz", LOG_FILE])
def test_a_damaged_cache_is_trained_again(broken):
    policy, _, path = find_or_make(CONFIG)
    path.with_name(broken).write_bytes(b"broken")
    assert np.array_equal(find_or_make(CONFIG)[0].q, policy.q)
    assert path.with_name(broken).stat().st_size > 1000


@pytest.mark.long
def test_scenario_2_reaches_100_percent_of_all_900_starts():
    policy, log, _ = find_or_make(msgspec.structs.replace(CONFIG, learning=LearningConfig()))
    result = evaluate(policy.process, policy.values)
    assert result.outcome.shape == (900,)
    assert result.rate(Outcome.SUCCESS) == 1.0
    # the exact optimum is 14.85 cm and 11.917 moves (agent.mdp.bound)
    assert 14.85 <= result.mean_path_cells() < 17.0
    assert 11.91 <= result.mean_steps() < 12.5
    assert log.success[-100:].min() == 1.0

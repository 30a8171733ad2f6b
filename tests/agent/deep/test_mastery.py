"""A network masters the paper's scenarios, and drives robots in the co-simulation."""

import msgspec
import pytest

from agent.deep.learning_grid import SHAPING
from agent.deep.policy import NetworkConfig
from agent.study.evaluate import EvaluationReport
from agent.training.policy import Seed
from cosim.base.progress import silent
from cosim.model.outcome import Outcome
from cosim.model.scenario_file import find_scenario

STEPS = 800_000  # some minutes of a core


@pytest.mark.slow
@pytest.mark.parametrize("name", ["2", "3", "4"])
def test_double_q_succeeds_from_nearly_all_starts(name, tmp_path, command):
    from agent.deep.learners import train

    process = SHAPING["ddqn"].process
    config = NetworkConfig(find_scenario(name), process, "ddqn", STEPS, Seed(0))
    curve = []
    policy = train(config, silent, curve.append, enough=0.99)
    assert policy.evaluate().rate(Outcome.SUCCESS) >= 0.99
    policy.save(tmp_path / "policy.npz")
    options = ("--starts", 4, "--shield", "--out", tmp_path / "out", "--json")
    done = command("evaluate", tmp_path / "policy.npz", *options)
    assert done.returncode == 0, done.stderr
    last = done.stdout.splitlines()[-1]
    (row,) = msgspec.json.decode(last, type=EvaluationReport).policies
    assert (row.episodes, row.collision, row.out_of_board) == (4, 0.0, 0.0)
    assert row.success is not None
    assert row.success >= 0.75

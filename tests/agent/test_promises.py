"""What the README and docs say policies achieve in the dynamics, from 200 starts each."""

import msgspec
import pytest

import agent
from agent.mdp.config import ProcessConfig
from agent.mdp.exact import joint_starts
from agent.mdp.interpretations import build_process
from agent.mdp.optimum import optimum
from agent.study.report import Report
from cosim.model.scenario_file import find_scenario


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "method", "least", "longest_s"),
    [("4", "shortest", 0.99, 100.0), ("4-cross", "planned", 0.98, 200.0)],
)
def test_robots_get_there_in_time(name, method, least, longest_s, tmp_path, command):
    policy = tmp_path / "policy.npz"
    agent.train(name, method=method).save(policy)
    options = ("--starts", 200, "--through", "--shield", "--recordings", 0, "--json")
    done = command("evaluate", policy, *options, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    (row,) = msgspec.json.decode(done.stdout.splitlines()[-1], type=Report).rows
    assert (row.episodes, row.collision, row.out_of_board) == (200, 0.0, 0.0)
    assert row.success is not None and row.success >= least
    assert row.sim_time_s is not None and row.sim_time_s <= longest_s
    if method == "shortest":
        process = build_process(find_scenario(name), ProcessConfig())
        bound = optimum(process).of_starts(joint_starts(process), 30)[0].mean()
        assert row.path_length_cm is not None and row.path_length_cm <= 1.15 * bound

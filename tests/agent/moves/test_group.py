"""Plans of groups in space and time: least times, commitments, and what is refused."""

import numpy as np
import pytest

from agent.mdp.exact import some_starts
from agent.moves.times import mean_seconds
from agent.training.methods import method_config
from agent.training.policy import GroupPolicy, load_policy
from agent.training.store import find_or_make
from cosim.base.errors import UserError
from cosim.model.outcome import SUCCESS
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.onboard.features import DIRECTIONS
from tests.agent.moves.test_pair import observe

ALONE = Scenario("alone", "", ((8, 1),), (((1, 1),),), columns=12, rows=8, zone=(0, 0, 0, 0))
SWAP = Scenario(
    "swap", "", ((16, 8), (2, 8)), (((2, 4),), ((16, 12),)), columns=19, rows=17, zone=(0, 0, 0, 0)
)


def planned(scenario):
    return GroupPolicy.computed(method_config("planned", scenario))


@pytest.mark.slow
def test_a_robot_alone_plans_the_least_time():
    policy = planned(ALONE)
    assert policy.config.moves is not None
    seconds = mean_seconds(policy.config.moves)
    values = policy.act(observe(ALONE, [(1, 1)], [0])).values
    assert values is not None
    assert values[0, 0] == pytest.approx(-7 * seconds[0, 0], rel=1e-6)
    assert np.isnan(values[0, 1:]).all()


@pytest.mark.long
def test_a_plan_keeps_clear_of_a_move_under_way():
    policy = planned(SWAP)
    for other, goal in (((8, 8), (8, 7)), ((8, 4), (8, 5)), ((8, 8), (9, 8))):
        decision = policy.act(observe(SWAP, [(2, 8), other], [0, 2], [(2, 8), goal]))
        after = np.array([2, 8]) + DIRECTIONS[decision.action[0]]
        assert decision.values is not None
        for end in (other, goal):
            assert ((after - end) ** 2).sum() > 25
        assert np.isnan(decision.values[1]).all()  # it ends its move first


class Cleared(dict):
    """Plans that another thread clears as soon as a policy has looked for one."""

    def __contains__(self, key: object) -> bool:
        found = super().__contains__(key)
        self.clear()
        return found


@pytest.mark.long
def test_a_policy_may_forget_its_plans_while_another_thread_asks():
    policy, seen = planned(SWAP), observe(SWAP, [(2, 8), (16, 12)], [0, 2])
    vars(policy)["_plans"] = Cleared()
    first, again = (policy.q_values(seen).tolist() for _ in range(2))
    assert first == again


def test_robots_that_have_arrived_are_passed():
    group = planned(SWAP).group
    past, alone = group.around[0, 0b10], group.around[0, 0]
    known = np.isfinite(past)
    assert (past[known] >= alone[known] - 1e-3).all()
    cells = group.board.at[known.all(axis=1)]
    parked = np.array(SWAP.targets[1])
    assert ((cells - parked) ** 2).sum(axis=1).min() >= 25


@pytest.mark.long
@pytest.mark.parametrize("name", ["4-cross", "4-ring", "6-swap"])
def test_groups_arrive_on_the_grid(name):
    policy, log, path = find_or_make(method_config("planned", find_scenario(name)))
    assert isinstance(policy, GroupPolicy)
    assert log is None
    assert path.stat().st_size < 200_000
    found = policy.evaluate_on_grid(some_starts(policy.process, 3))
    assert (found.outcome == SUCCESS).all()


def test_a_policy_is_kept_in_its_file(tmp_path):
    policy = planned(SWAP)
    policy.save(tmp_path / "planned.npz")
    read = load_policy(tmp_path / "planned.npz", SWAP)
    assert isinstance(read, GroupPolicy)
    assert read.config.method == "planned"
    assert read.digest() == policy.digest()
    seen = observe(SWAP, [starts[0] for starts in SWAP.starts], [0, 0])
    assert read.act(seen).action.tolist() == policy.act(seen).action.tolist()


def test_groups_that_are_too_large_are_refused():
    starts, targets = (tuple((x, y) for x in range(0, 54, 6)) for y in (0, 20))
    many = Scenario("many", "", targets, tuple((cell,) for cell in starts), 60, 30)
    with pytest.raises(UserError, match="9 robots on 1800 cells, which is too much to plan for"):
        planned(many)

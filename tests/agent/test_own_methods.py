"""Methods of a user: generated ones by every door, edited ones, and mistakes in them."""

import importlib
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import minirobots as mr
from agent.mdp.config import ProcessConfig
from agent.training.learning import build_learning
from agent.training.loop import learn
from agent.training.methods import METHODS, computed, find_method, learner
from agent.training.policy import Policy
from agent.training.qlearning import best_action
from agent.training.rules import compiled
from agent.training.runs import policy_paths
from agent.training.settings import LearningConfig
from cosim.base.errors import UserError
from cosim.base.storage import cache_dir
from tests.agent.conftest import BOARD, NEAR

# A rule with any number of tables, each of which is valued by the next one.
RULE = '''
import numpy as np
from agent.mdp.config import ProcessConfig
from agent.training.methods import learner
from agent.training.settings import LearningConfig

def short(_):
    return ProcessConfig(step_limit=50), LearningConfig(episodes=2000, eta=0.1)

@learner(tables={tables}{settings})
def rule(q, s, a, reward, discount, s_next, a_next, eta, coin):
    """Learns with {tables} tables."""
    k = np.int64(coin % np.uint64({tables}))
    best = q[k, s_next].argmax()
    q[k, s, a] += eta * (reward + discount * q[(k + 1) % {tables}, s_next, best] - q[k, s, a])
'''
EPISODES = 2000
BRIEF: Any = {"jobs": 1, "time_limit": 2.0, "progress": None}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working folder from which modules are imported, with a scenario."""
    (tmp_path / "near.toml").write_text(BOARD)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    yield tmp_path
    sys.modules.pop("own_rules", None)
    for name in [name for name in METHODS if name.startswith("own_rules:")]:
        del METHODS[name]


def kept() -> list[Path]:
    """Files of the cache that an own method has made."""
    files = cache_dir("policies").glob("near-*/policy.json")
    return [file for file in files if "own_rules" in file.read_text("utf-8")]


def by_commands(command, folder: Path, *, short: bool) -> list[Policy]:
    """Policies that the commands `train` and `run` make of the rule."""
    named = ("--scenario", "near.toml", "--method", "own_rules:rule", "--jobs", 1)
    few = ("--learning.episodes", EPISODES) if short else ()
    done = command("train", *named, *few, "--out", "trained")
    assert done.returncode == 0, done.stderr
    again = command("train", *named, *few, "--out", "trained")
    assert (again.returncode, again.stderr.count("\n")) == (2, 1)
    assert "whose code may have changed since" in again.stderr
    few = ("--train-episodes", EPISODES) if short else ()
    options = ("--episodes", 1, "--time-limit", 2, "--record", "none", "--out", "run")
    done = command("run", *named, *few, *options)
    assert done.returncode == 0, done.stderr
    (path,) = policy_paths(folder / "trained")
    return [Policy.load(path), Policy.load(folder / "run" / "policy.npz")]


@pytest.mark.long
@pytest.mark.parametrize(
    ("tables", "settings"),
    [
        (1, ""),
        (2, ", settings=short"),
        *(pytest.param(*rest, marks=pytest.mark.slow) for rest in ((2, ""), (3, ""))),
        *(pytest.param(n, ", settings=short", marks=pytest.mark.slow) for n in (1, 3)),
    ],
)
def test_every_door_makes_the_same_policy(folder, command, tables, settings):
    (folder / "own_rules.py").write_text(RULE.format(tables=tables, settings=settings))
    name, board = "own_rules:rule", "near.toml"
    number: Any = {} if settings else {"episodes": EPISODES}
    policy: Any = mr.train(board, method=name, progress=None, **number)
    assert len(policy.q) == tables
    assert all(np.count_nonzero(table) for table in policy.q)
    assert policy.config.process.step_limit == (50 if settings else ProcessConfig.step_limit)
    trained, run = by_commands(command, folder, short=not settings)
    assert trained.config.process == policy.config.process
    if tables == 2:  # the seed is another one: train again
        assert trained.digest() == learn(trained.config)[0].digest()
    assert (run.config, run.digest()) == (policy.config, policy.digest())
    if settings:  # else the others train as many episodes as the paper
        expected = mr.evaluate(policy, starts=1, **BRIEF).digest
        assert mr.evaluate(name, board, starts=1, **BRIEF).digest == expected
        (row,) = mr.study([find_method(name)], board, episodes=1, **BRIEF).rows
        assert row.digest == expected
    assert not kept()


def brief(_: Any) -> tuple[ProcessConfig, LearningConfig]:
    return ProcessConfig(features=("x", "y")), LearningConfig(episodes=50, eta=0.5)


def trained(method: Any, **options: Any) -> Any:
    return mr.train(NEAR, method=method, progress=None, **options)


EDITED = """
from agent.training.methods import computed, learner
from tests.agent.test_own_methods import brief
import numpy as np

FACTOR = {factor}

@learner(settings=brief)
def rule(q, s, a, reward, discount, s_next, a_next, eta, coin):
    q[0, s, a] = FACTOR

@computed(settings=brief)
def function(process):
    return np.full((2, process.state_count, 8), FACTOR)
"""


@pytest.mark.parametrize("name", [pytest.param("rule", marks=pytest.mark.long), "function"])
def test_edited_code_makes_a_new_policy(folder, name):
    """After an edit in a running session, another start, and another value of a global name."""
    file = folder / "own_rules.py"
    file.write_text(EDITED.format(factor=1.0))
    own: Any = importlib.import_module("own_rules")
    assert trained(getattr(own, name)).q.max() == 1.0
    file.write_text(EDITED.format(factor=2.0))
    assert trained(f"own_rules:{name}").q.max() == 1.0  # what the session has imported
    own = importlib.reload(own)
    assert trained(getattr(own, name)).q.max() == 2.0
    own.FACTOR = 3.0  # as a cell of a notebook would set it
    assert trained(f"own_rules:{name}").q.max() == 3.0
    assert not kept()


def test_a_method_of_a_built_in_name_is_not_found_for_that():
    usual: Any = find_method("shortest")
    other = type(usual)("shortest", "", settings=brief, compute=usual.compute)
    assert other.own
    assert not usual.own


@pytest.mark.long
@settings(max_examples=50)
@given(q=arrays(np.float32, st.tuples(st.integers(1, 3), st.just(1), st.just(1), st.just(8)),
                elements=st.integers(-3, 3).map(float)))  # fmt: skip
def test_robots_act_by_the_sum_of_all_tables(q):
    learning = build_learning(LearningConfig(), tables=len(q))
    assert best_action(learning, q, 0, np.uint64(0)) == q.sum(axis=0)[0, 0].argmax()


def out_of_bounds(q, s, a, reward, discount, s_next, a_next, eta, coin):
    q[1, s, a] += eta * reward


def diverges(q, s, a, reward, discount, s_next, a_next, eta, coin):
    q[0, s, a] = np.inf


def raises(q, s, a, reward, discount, s_next, a_next, eta, coin):
    if a > 3:
        raise ValueError("too far")


@pytest.mark.long
@pytest.mark.parametrize(
    ("rule", "message"),
    [
        (out_of_bounds, r"rule .*:out_of_bounds failed \(IndexError: index .* out of bounds"),
        (diverges, r"method .*:diverges has values that are not finite in its tables after \d+"),
        (raises, r"rule .*:raises failed \(ValueError: too far\)"),
    ],
)
def test_what_goes_wrong_in_a_rule_is_named(rule, message):
    with pytest.raises(UserError, match=message):
        trained(learner(settings=brief)(rule))


def counts(q, s, a, reward, discount, s_next, a_next, eta, coin):
    q[0, s, a] -= 1.0
    if discount > 0.0:
        q[1, s_next, a_next] -= 1.0


@pytest.mark.long
@pytest.mark.parametrize("ahead", [True, False])
def test_a_rule_gets_the_next_action_of_its_robot_or_the_greedy_one(ahead):
    """Actions that were announced are those that are done, but for the first of an episode."""
    lone = replace(NEAR, targets=NEAR.targets[:1], starts=NEAR.starts[:1])
    method = learner(tables=2, ahead=ahead, settings=brief)(counts)
    policy: Any = mr.train(lone, method=method, progress=None)
    first = (policy.q[0] != policy.q[1]).any(axis=2).nonzero()[1]
    starts = [lone.rows * x + y for x, y in lone.starts[0]]
    assert (set(first.tolist()) <= {*starts}) == ahead


def misspelt(q, s, a, reward, discount, s_next, a_next, eta, coin):
    q[0, s, a] += etta * reward  # noqa: F821 # pyright: ignore[reportUndefinedVariable]


def no_attribute(q, s, a, reward, discount, s_next, a_next, eta, coin):
    q[0, s, a] = q[0, s].maxx()


def of_strings(q, s, a, reward, discount, s_next, a_next, eta, coin):
    q[0, s, a] = "x"


def too_few(q, s, a, reward):
    q[0, s, a] = reward


def yields(q, s, a, reward, discount, s_next, a_next, eta, coin):
    yield 1


def deep(q, s, a, reward, discount, s_next, a_next, eta, coin):
    q[0, s, a, 0, 0] = reward


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        (misspelt, r"TypingError: NameError: name 'etta' is not defined"),
        (no_attribute, r"Unknown attribute 'maxx' of type array\(float32, 1d, A\), line \d+"),
        (of_strings, r"No implementation of function Function\(<built-in function setitem>\)"),
        (too_few, r"TypeError: Signature mismatch: 9 argument types given, but function takes 4"),
        (deep, r"No implementation of function .*setitem"),
        (yields, r"the rule yields returns .*; have it update q, and return nothing"),
    ],
)
def test_a_rule_that_cannot_be_compiled_is_named_on_one_line(rule, message):
    with pytest.raises(UserError, match=message) as raised:
        compiled(rule.__name__, rule)
    assert f"rule {rule.__name__}" in str(raised.value)
    assert len(str(raised.value)) < 400
    assert not {"\n", "\x1b"} & {*str(raised.value)}


def sarsa(q, s, a, reward, discount, s_next, a_next, eta, coin):
    q[0, s, a] += eta * (reward + discount * q[0, s_next, a_next] - q[0, s, a])


def on_moves(_):
    return ProcessConfig(clearance_m=0.01), LearningConfig(episodes=50)


@pytest.mark.parametrize(
    ("facts", "message"),
    [
        ({"through": lambda _: False}, "learner: through is unknown; choose one of tables"),
        ({"compute": lambda _: None}, "learner: compute is unknown"),
        ({"tables": 0}, "learner: tables = 0 is invalid"),
        ({"tables": 1.5}, r"learner: tables = 1\.5 is invalid"),
        ({"settings": lambda _: None}, "settings of method .*:sarsa returned None; expected"),
        ({"settings": lambda _: (1, 2)}, r"returned \(1, 2\); expected a ProcessConfig"),
        ({"settings": lambda _: {}["a"]}, r"settings of method .* failed \(KeyError: 'a'\)"),
        ({"ahead": 1}, "learner: ahead = 1 is invalid"),
        ({"settings": on_moves}, r"clearance_m = 0\.01 has no effect in training on the grid"),
    ],
)
def test_what_a_rule_does_not_use_is_refused(facts, message):
    with pytest.raises(UserError, match=message):
        trained(learner(**facts)(sarsa))


@pytest.mark.parametrize(
    "make",
    [
        lambda shape: np.zeros((shape[0], shape[1] - 1, 8)),
        lambda shape: np.zeros((1, *shape[1:])),
        lambda shape: np.zeros(shape[1:]),
        lambda shape: np.full(shape, np.nan),
        lambda shape: np.full(shape, 1e300),
        lambda shape: np.zeros(shape, object),
        lambda shape: np.zeros(shape, complex),
        np.ma.masked_all,
        lambda _: None,
    ],
)
def test_computed_values_are_those_of_the_process_or_refused(make):
    @computed(settings=brief)
    def values(process):
        return make((2, process.state_count, 8))

    with pytest.raises(UserError, match=r"values returned .*; expected finite numbers of shape"):
        trained(values)


def test_a_computed_method_that_fails_or_wants_moves_is_refused():
    @computed(settings=brief)
    def fails(process):
        raise KeyError("board")

    with pytest.raises(UserError, match=r"method .*fails failed \(KeyError: 'board'\)"):
        trained(fails)
    with pytest.raises(UserError, match="computed: through is unknown"):
        computed(through=lambda _: True)

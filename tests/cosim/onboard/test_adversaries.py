"""Policies that want robots to collide do, without the shield, and do not with it."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.reliability.adversaries import BLOCK, KINDS, Options, attack, lessons, simulate
from cosim.base.errors import UserError
from cosim.simulation.options import SimulationOptions, resolve
from tests.references.colliding import REACH, Greedy, Learnt, arena


@pytest.fixture(scope="module")
def table():
    """What 60 episodes teach."""
    return lessons(resolve(SimulationOptions(), arena(2)), episodes=60)


@pytest.mark.slow
def test_lessons_lead_to_the_other_robot(table):
    """Straight at it is worth more than straight away from it."""
    toward, away = [], []
    for offset in np.argwhere(table.any(axis=2)):
        straight = Greedy(np.random.default_rng(0)).choice(offset - REACH)
        toward.append(table[tuple(offset)][straight])
        away.append(table[tuple(offset)][(straight + 4) % 8])
    assert np.count_nonzero(toward) > 10
    assert np.sum(toward) > 0.0 > np.sum(away)


def test_one_kind_has_its_episodes_of_all(tmp_path):
    options = Options(kinds=("random",), jobs=1, out=tmp_path)
    (block,) = attack(options, True, BLOCK + 1)
    assert (block.number, block.kind, block.episodes) == (1, "random", 1)


def test_nothing_is_learnt_from_waiting():
    step: Any = SimpleNamespace(
        samples=SimpleNamespace(position=np.array([[[0.1, 0.1, 0.0], [0.2, 0.1, 0.0]]] * 2)),
        before=SimpleNamespace(cells=np.array([[10, 10], [20, 10]])),
        after=SimpleNamespace(cells=np.array([[10, 10], [20, 10]])),
        action=np.array([-1, 3]),
    )
    step.samples.position[1, 1, 0] = 0.19  # the second comes a centimetre closer
    learner = Learnt(np.random.default_rng(0), np.zeros((2 * REACH + 1,) * 2 + (8,)))
    learner.learn(step)
    assert [tuple(entry) for entry in np.argwhere(learner.q)] == [(0, REACH, 3)]


def test_kinds_without_episodes_are_refused(tmp_path):
    with pytest.raises(UserError, match="no block of learnt; ask for 1000"):
        attack(Options(kinds=("learnt",), jobs=1, out=tmp_path), True, BLOCK)


@pytest.mark.long
@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[pytest.mark.slow] * (kind == "short")) for kind in KINDS]
)
def test_the_shield_holds_them_off(kind, table):
    blocks = []
    for shield in (False, True):
        setup = resolve(SimulationOptions(shield=shield), arena(2))
        timing = setup.config.timing._replace(episode_limit_s=KINDS[kind])
        mine = setup._replace(config=replace(setup.config, timing=timing))
        blocks.append(simulate(3, kind, 24, mine, table))
    without, with_shield = blocks
    assert without.contacts > 0
    assert with_shield.contacts == with_shield.off_board == 0
    assert with_shield.least_gap_mm > 0.0
    assert with_shield.stops > 0
    again = simulate(3, kind, 24, mine, table)
    assert again == with_shield
    assert np.isfinite(table).all()

"""Policies that want robots to collide do, without the shield, and do not with it."""

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cosim.coupling.rl_step import Step, SupportsAct
from cosim.model.outcome import Outcome
from cosim.onboard.features import DIRECTION_COUNT
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.options import SimulationOptions, resolve
from cosim.simulation.result import EpisodeResult
from cosim.simulation.tasks import Task, simulate_tasks
from tests.references.colliding import REACH, Greedy, Learnt, Random, arena, near_starts

# s of their episodes
KINDS = {"short": 2.0, "random": 3.0, "greedy": 4.0, "learnt": 4.0}
LESSONS, LESSON_S = 60, 8.0  # episodes that the learnt begins with, without the shield


def simulate(
    setup: tuple[Any, Any, Any],
    policy: SupportsAct,
    seeds: Sequence[np.random.SeedSequence],
    watch: Callable[[Step, RunningEpisode, float], None],
) -> list[EpisodeResult]:
    """Episodes one batch after the other, so that a learner learns in one order."""
    scenario, config, fmu = setup
    tasks = [
        Task(scenario, fmu, config, policy, starts, seed, watch=watch)
        for seed in seeds
        for starts in [near_starts(scenario, np.random.default_rng(seed))]
    ]
    return [result for _, result in simulate_tasks(tasks, 1)]


@pytest.fixture(scope="module")
def table() -> np.ndarray:
    """What the episodes of robots that drive anywhere teach."""
    scenario, config, fmu = resolve(SimulationOptions(), arena(2))
    setup = scenario, config.having("test", episode_limit_s=LESSON_S), fmu
    root = np.random.SeedSequence(0)
    random = Random(np.random.default_rng(root))
    learner = Learnt(random.rng, np.zeros((2 * REACH + 1, 2 * REACH + 1, DIRECTION_COUNT)))
    simulate(setup, random, root.spawn(LESSONS), lambda step, *_: learner.learn(step))
    return learner.q


def attack(kind: str, shield: bool, table: np.ndarray) -> tuple[list[EpisodeResult], int]:
    """Results of 24 episodes, and how many moves the shield ended."""
    scenario, config, fmu = resolve(SimulationOptions(shield=shield), arena(2))
    setup = scenario, config.having("test", episode_limit_s=KINDS[kind]), fmu
    root = np.random.SeedSequence(3)
    rng = np.random.default_rng(root)
    learnt = Learnt(rng, table.copy()) if kind == "learnt" else None
    stops = 0

    def watch(step: Step, episode: RunningEpisode, _: float) -> None:
        nonlocal stops
        if learnt:
            learnt.learn(step)
        if step.outcome:
            stops += episode.shield_stops

    policy = learnt or {"random": Random}.get(kind, Greedy)(rng)
    return simulate(setup, policy, root.spawn(24), watch), stops


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


@pytest.mark.long
@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[pytest.mark.slow] * (kind == "short")) for kind in KINDS]
)
def test_the_shield_holds_them_off(kind, table):
    without, _ = attack(kind, False, table)
    assert Outcome.COLLISION in [result.outcome for result in without]
    results, stops = attack(kind, True, table)
    assert {result.outcome for result in results} == {Outcome.TIMEOUT}
    assert min(result.min_distance_cm or 0.0 for result in results) > 5.0
    assert stops > 0

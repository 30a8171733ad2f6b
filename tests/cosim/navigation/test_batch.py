"""Episodes that share a batch are, bit for bit, those that have a co-simulation to themselves."""

from pathlib import Path

import numpy as np
import pytest

from cosim.base.config import ConfigError, CoSimConfig
from cosim.base.params import TABLE_II, MotorParams
from cosim.episodes import Task, simulate_tasks
from cosim.navigation.batch import Batch
from cosim.scenarios.scenario import Scenario

EAST, NORTH, WEST, SOUTH = 0, 2, 4, 6
LARGE = Scenario("large", "", ((5, 20), (20, 20)), (((5, 5),), ((20, 5),)))
# a small board, and an obstacle on it
SMALL = Scenario(
    "small",
    "",
    ((4, 16), (14, 16)),
    (((4, 4),), ((14, 4),)),
    columns=20,
    rows=20,
    zone=(0, 0, 0, 0),
    obstacles=((9, 6),),
)


class Constant:
    """Drives every robot the same way for ever."""

    def __init__(self, *directions: int) -> None:
        self._directions = np.array(directions)

    def act(self, observation):
        return self._directions


# scenario, starts, directions; the second one leaves the board within seconds
EPISODES = [
    (LARGE, ((5, 5), (20, 5)), (NORTH, NORTH)),
    (SMALL, ((4, 0), (14, 4)), (SOUTH, NORTH)),
    (LARGE, ((5, 5), (12, 5)), (NORTH, SOUTH)),
    (SMALL, ((4, 4), (14, 10)), (NORTH, NORTH)),
]
COUPLINGS = [{}, {"order": "jacobi", "reaction": True}]
DRAWN = ("K_T", "R", "J", "r")
Pairs = tuple[tuple[MotorParams, MotorParams], ...]


def own_motors(number: int) -> Pairs:
    """Of an episode: each has others, the last one those of the configuration."""
    spread = 0.1 if number < 3 else 0.0
    factors = 1.0 + np.random.default_rng(number).uniform(-spread, spread, (2, 2, 4))

    def own(row: np.ndarray) -> MotorParams:
        return TABLE_II._replace(
            **{p: getattr(TABLE_II, p) * f for p, f in zip(DRAWN, row.tolist(), strict=True)}
        )

    return tuple((own(d), own(e)) for d, e in factors)


def alone(number: int, fmu: Path, config: CoSimConfig, motors: Pairs | None, steps: int) -> list:
    scenario, starts, directions = EPISODES[number]
    batch = Batch(fmu, config, robots=2, places=1)
    batch.begin(0, scenario, starts, np.random.SeedSequence(number), motors=motors)
    found = [batch.advance({0: np.array(directions)})[0] for _ in range(steps)]
    batch.close()
    return found


@pytest.mark.parametrize("coupling", COUPLINGS, ids=["gauss-seidel", "jacobi-reaction"])
@pytest.mark.parametrize("fmu", ["motor_fmu", "array_fmu"])
@pytest.mark.parametrize("differ", [False, True], ids=["equal", "own"])
def test_steps_do_not_depend_on_who_shares_the_batch(fmu, coupling, differ, request):
    path, config = request.getfixturevalue(fmu), CoSimConfig(**coupling)
    batch = Batch(path, config, robots=2, places=3)
    motors = {number: own_motors(number) if differ else None for number in range(4)}

    def begin(place: int, number: int) -> None:
        seed = np.random.SeedSequence(number)
        batch.begin(place, *EPISODES[number][:2], seed, motors=motors[number])

    held = {place: place for place in range(3)}
    found: dict[int, list] = {number: [] for number in range(4)}
    for place, number in held.items():
        begin(place, number)
    for _ in range(4):
        actions = {place: np.array(EPISODES[held[place]][2]) for place in batch.going_on()}
        for place, step in batch.advance(actions).items():
            found[held[place]].append(step)
            if step.outcome and 3 not in held.values():
                held[place] = 3
                begin(place, 3)
    batch.close()
    assert found[1][-1].outcome == "out_of_board"
    assert len(found[3]) > 1  # begun where that ended
    for number, steps in found.items():
        expected = alone(number, path, config, motors[number], len(steps))
        for ours, theirs in zip(steps, expected, strict=True):
            for a, b in zip(
                (*ours.samples, *ours.raw), (*theirs.samples, *theirs.raw), strict=True
            ):
                assert np.array_equal(a, b)
            assert np.array_equal(ours.after.cells, theirs.after.cells)
            assert ours.outcome == theirs.outcome


def test_results_do_not_depend_on_threads_or_places(array_fmu):
    timing = CoSimConfig().timing._replace(episode_limit_s=6.0)
    config = CoSimConfig(timing=timing)
    tasks = [
        Task(scenario, array_fmu, config, Constant(*way), starts, np.random.SeedSequence(number))
        for number, (scenario, starts, way) in enumerate(EPISODES)
    ]

    def results(some, threads):
        found = dict(simulate_tasks(some, threads))
        return [found[k] for k in sorted(found)]

    together, in_threads = results(tasks, 1), results(tasks, 2)
    one_by_one = [results([task], 1)[0] for task in tasks]
    for k, result in enumerate(together):
        for other in (in_threads[k], one_by_one[k]):
            for name in result.__struct_fields__:
                if name != "realtime_factor":
                    assert getattr(result, name) == getattr(other, name), name
    assert {r.outcome for r in together} == {"out_of_board", "timeout"}


def test_errors_of_a_thread_are_raised_where_results_are_taken(array_fmu):
    class Broken:
        def act(self, observation):
            raise ValueError("no action")

    scenario, starts, _ = EPISODES[0]
    task = Task(scenario, array_fmu, CoSimConfig(), Broken(), starts, np.random.SeedSequence(0))
    with pytest.raises(ValueError, match="no action"):
        list(simulate_tasks([task] * 3, 2))


def test_what_does_not_fit_a_batch_is_refused(array_fmu):
    with pytest.raises(ConfigError, match="lanes = 2 has no effect with the driver reference"):
        Batch(array_fmu, CoSimConfig(), 2, 1, "reference", lanes=2)
    batch, seed = Batch(array_fmu, CoSimConfig(), 1, 2), np.random.SeedSequence(0)
    with pytest.raises(ConfigError, match="scenario large has 2 robots, a place of the batch 1"):
        batch.begin(0, LARGE, ((5, 5), (20, 5)), seed)
    with pytest.raises(ConfigError, match="by more than the safety margin"):
        batch.begin(0, LARGE, ((5, 5), (20, 5)), seed, CoSimConfig(order="jacobi"))

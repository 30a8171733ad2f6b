"""The log of an episode: what a user reads to see why a robot failed."""

import numpy as np

from cosim.coupling.rl_step import Step
from cosim.coupling.signals import RawSamples, new_raw_samples, new_samples
from cosim.model.config import CoSimConfig
from cosim.model.outcome import Outcome
from cosim.model.params import TIMING
from cosim.model.scenario import Scenario
from cosim.onboard.features import Observation
from cosim.recording.episode_log import EpisodeLog

SCENARIO = Scenario("pair", "", ((3, 27), (27, 2)), (((3, 2),), ((27, 27),)))
CONFIG = CoSimConfig(timing=TIMING._replace(rl_step_s=0.01))
NOTHING = np.full(2, np.nan)


def step(
    number: int = 0, outcome: str = "", decided: bool = False, touching=(), apart_m: float = 0.0499
) -> Step:
    """An RL step of ten periods; robots touch in the given ones, side by side on row 5."""
    samples = new_samples(10, 2)
    samples.position[:, 0, :2] = 0.055, 0.055
    samples.position[:, 1, :2] = 0.055 + apart_m, 0.055
    samples.touching_share[list(touching)] = 0.4
    seen = Observation(np.array([(5, 5), (10, 5)]), *np.zeros((3, 2), dtype=int))
    return Step(
        number,
        1000 * number,
        seen,
        seen,
        np.array([0, 4]),
        np.array([decided, False]),
        np.zeros(2, dtype=bool),
        samples,
        RawSamples(*new_raw_samples(0, 2)),
        np.zeros(2, dtype=int),
        Outcome(outcome),
        2.0,
        np.zeros(2),
        (0, 1),
        np.empty((0, 2, 7)),
    )


def told(
    log: EpisodeLog, step: Step, reward: np.ndarray = NOTHING
) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Levels and texts of the lines, and what they say of states."""
    lines = log.lines(step, reward)
    states = [(line.entity, line.state) for line in lines if line.entity]
    return [(line.level, line.text) for line in lines], states


def test_collision_names_robots_time_and_distance():
    log = EpisodeLog(SCENARIO, CONFIG)
    lines = log.lines(step(outcome="collision", touching=[7, 8, 9]), np.full(2, -100.0))
    assert [line.level for line in lines] == ["WARN", "INFO", "INFO", "ERROR"]
    assert lines[0].time_s == 0.008
    assert lines[0].text == ("r1 and r2 touch at 0.008 s: centres 4.99 cm apart, diameter 5.00 cm")
    assert lines[1].text == "r1 ends its move in (5, 5), reward -100.00"
    assert lines[-1].text == "episode ends: collision"


def test_a_contact_that_rattles_is_told_once():
    log = EpisodeLog(SCENARIO, CONFIG)
    assert len(log.lines(step(0, touching=[1, 4, 6]), NOTHING)) == 1
    assert log.lines(step(1, touching=[0, 3]), NOTHING) == []
    assert len(log.lines(step(200, touching=[3]), NOTHING)) == 1


def test_robots_that_touch_others_are_not_a_pair():
    assert EpisodeLog(SCENARIO, CONFIG).lines(step(touching=[1], apart_m=0.2), NOTHING) == []


def test_moves_are_decided_given_up_and_ended():
    log, move = EpisodeLog(SCENARIO, CONFIG), "/rl/r1/move"
    heads = ("INFO", "r1 in (5, 5) heads for 0°")
    assert told(log, step(0, decided=True)) == ([heads], [(move, "0°")])
    given_up = ("WARN", "r1 gives its move up after 40 s")
    states = [(move, "given up"), (move, "0°")]
    assert told(log, step(1, decided=True)) == ([given_up, heads], states)
    ended = step(2)._replace(completed=np.array([True, False]))
    assert told(log, ended, np.full(2, -1.0))[1] == [(move, "ended")]
    assert told(log, step(3, decided=True))[1] == [(move, "0°")]


def test_timeout_says_who_is_missing_and_how_far():
    lines, states = told(EpisodeLog(SCENARIO, CONFIG), step(outcome="timeout"))
    assert lines[0] == ("WARN", "r1 has not arrived: target 22.1 cm away")
    assert lines[-1] == ("ERROR", "episode ends: timeout")
    assert len(lines) == 3
    failures = [(f"/rl/r{robot}/failure", "has not arrived") for robot in (1, 2)]
    assert states == [*failures, ("/outcome", "timeout")]


def test_leaving_the_board_names_the_robot_and_the_place():
    lost = step(outcome="out_of_board")
    lost.samples.position[-1, 1, 0] = 0.3002
    lines, states = told(EpisodeLog(SCENARIO, CONFIG), lost)
    # whether anybody says a reward or not
    ends = ["r1 ends its move in (5, 5)", "r2 ends its move in (10, 5)"]
    assert [text for _, text in lines[:2]] == ends
    assert lines[2:] == [
        ("WARN", "r2 leaves the board at (30.02, 5.50) cm"),
        ("ERROR", "episode ends: out_of_board"),
    ]
    assert states == [
        ("/rl/r1/move", "ended"),
        ("/rl/r2/move", "ended"),
        ("/rl/r2/failure", "leaves the board"),
        ("/outcome", "out_of_board"),
    ]

"""The map between motor speeds and motion, of trials that are made up: by definition, not by it."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import UserError
from cosim.calibration.report import speed_rows
from cosim.calibration.speed_map import BOUNCING_SHARE, DIRECTIONS, DRIVES, Calibration
from cosim.model.config import CoSimConfig
from cosim.model.params import STEERING, Drive

SPEEDS = (500.0, 600.0, 700.0, 800.0)


def calibration_of(
    restitution: float = 0.0,
    airborne: Sequence[float] = (0.0,) * len(SPEEDS),
    without: Sequence[str] = DRIVES[2:],
    **means: Sequence[float],
) -> Calibration:
    """Trials at SPEEDS, two of each 1 % apart; `means` of a primitive, others are linear."""
    rows = []
    for number, (name, direction) in enumerate(DIRECTIONS.items()):
        usual = [1e-5 * speed for speed in SPEEDS]
        points = zip(SPEEDS, means.get(name, usual), airborne, strict=True)
        for speed, mean, share in points if name not in without else ():
            for off in (-0.01, 0.01):
                motion = mean * (1.0 + off) * np.array(direction)
                rows.append((number, speed, *motion, share))
    number, speed, ahead, left, turn, share = np.array(rows).T
    none = np.zeros(len(rows))
    return Calibration(
        number,
        speed,
        none,
        none,
        np.ones(len(rows), dtype=bool),
        np.column_stack([0.99 * speed, np.full(len(rows), np.nan)]),
        ahead,
        left,
        turn,
        share,
        none,
        np.array(BOUNCING_SHARE if restitution else 0.0),
    )


@pytest.mark.parametrize("name", DIRECTIONS)
def test_a_curve_has_the_means_and_the_scatter_of_its_trials(name):
    curve = calibration_of(without=()).curve(name)
    np.testing.assert_allclose(curve.omega_rad_s, 0.99 * np.array(SPEEDS))
    np.testing.assert_allclose(curve.mean, 1e-5 * np.array(SPEEDS))
    np.testing.assert_allclose(curve.scatter, 0.01 * curve.mean)


@given(st.lists(st.integers(10, 90), min_size=4, max_size=4), st.floats(0.0, 1.0))
def test_a_motor_speed_is_the_slowest_that_realises_a_motion(mm_s_10, share):
    """Also where faster motors drive more slowly."""
    means = [1e-4 * value for value in mm_s_10]
    found = calibration_of(forwards=means)
    curve = found.curve("forwards")
    fine = np.union1d(curve.omega_rad_s, np.linspace(495.0, 792.0, 4001))
    motion = np.interp(fine, curve.omega_rad_s, curve.mean)
    assert found.largest("forwards") == pytest.approx(motion.max())
    value = curve.mean[0] + share * (motion.max() - curve.mean[0])
    omega = found.motor_speed("forwards", value)
    assert np.interp(omega, curve.omega_rad_s, curve.mean) == pytest.approx(value)
    assert omega <= fine[np.argmax(motion >= value * (1.0 - 1e-12))] + 1e-6


def test_the_table_has_mean_and_scatter_in_one_unit():
    rows = speed_rows(calibration_of(left_turn=[1e-3 * speed for speed in SPEEDS]))
    assert rows[0] == ("forwards", "495 rad/s", "5.00 mm/s", "0.05", "0.00%")
    assert rows[8] == ("left turn", "495 rad/s", "28.65 °/s", "0.29", "0.00%")


def test_hops_bound_the_speed_of_every_primitive():
    airborne = (0.0, 0.0, 0.05, 0.2)
    rigid, bouncing = (calibration_of(r, airborne) for r in (0.0, 0.1))
    assert rigid.hop_free_rad_s == pytest.approx(0.99 * 600.0)
    assert bouncing.hop_free_rad_s == pytest.approx(0.99 * 700.0)
    assert rigid.largest("left_turn") == pytest.approx(6e-3)
    with pytest.raises(UserError, match=r"6.5 mm/s .* largest possible is [56]\.\d\d mm/s"):
        rigid.motor_speed("backwards", 6.5e-3)
    with pytest.raises(UserError, match=r"4 mm/s .* least is 5\.00 mm/s"):
        rigid.motor_speed("forwards", 4e-3)
    with pytest.raises(UserError, match=r"hops at every motor speed from 495 rad/s"):
        _ = calibration_of(0.5, (0.2, 0.2, 0.2, 0.2)).hop_free_rad_s


def test_steering_gets_the_speeds_that_the_map_has():
    found = calibration_of(backwards=[0.9e-5 * speed for speed in SPEEDS])
    slow = STEERING._replace(drive_speed_m_s=6.3e-3, turn_rate_rad_s=6e-3)
    steering = found.resolved(CoSimConfig(steering=slow)).steering
    assert steering.forward_speed_rad_s == pytest.approx(0.99 * 630.0, abs=0.06)
    assert steering.backward_speed_rad_s == pytest.approx(0.99 * 700.0, abs=0.06)
    assert steering.turn_speed_rad_s == pytest.approx(0.99 * 600.0, abs=0.06)
    assert steering.max_speed_rad_s == pytest.approx(0.99 * 800.0, abs=0.06)
    assert (steering.side_speed_rad_s, steering.drives) == (0.0, STEERING.drives)
    fast = CoSimConfig(steering=STEERING._replace(drive_speed_m_s=7.5e-3, turn_rate_rad_s=6e-3))
    with pytest.raises(UserError, match=r"largest possible is 7\.20 mm/s"):  # backwards
        found.resolved(fast)
    assert found.resolved(fast, slower=True).steering.drive_speed_m_s == pytest.approx(7.2e-3)


def test_each_drive_keeps_its_difference_and_gain_and_has_a_speed_of_its_own():
    """Sideways, a robot drives as fast as it can."""
    found = calibration_of(leftwards=[0.5e-5 * speed for speed in SPEEDS], without=())
    drives = tuple(Drive(0.3, 0.5 + k, (1.0, -0.1 * k)) for k in range(4))
    asked = STEERING._replace(drive_speed_m_s=6.3e-3, turn_rate_rad_s=6e-3, drives=drives)
    steering = found.resolved(CoSimConfig(steering=asked)).steering
    speeds = [drive.speed for drive in steering.drives]
    assert speeds == pytest.approx([1.0, 1.0, 4e-3 / 6.3e-3, 1.0])
    assert [drive[1:] for drive in steering.drives] == [drive[1:] for drive in drives]
    assert steering.side_speed_rad_s == pytest.approx(0.99 * 800.0, abs=0.06)

"""Droplets: the trials of the real ones, and what is concluded of a simulation."""

import numpy as np
import pytest

from benchmarks.published.droplets import (
    BATCHES,
    HARDLY_MOVES,
    SHOWN,
    UNBALANCES_KG_M,
    Motion,
    batch_medians,
    draw,
    measured,
    measured_row,
    robot_rows,
    simulated,
    variant_row,
)
from cosim.fmi.motor import MotorFmu
from cosim.model.preset import find_preset

# Simulated robots that drive by their unbalance, and turn by what they drive.
DRIVE_M_S = np.linspace(0.5e-3, 7e-3, len(UNBALANCES_KG_M))
ALIKE = Motion(1.1 * DRIVE_M_S, 0.9 * DRIVE_M_S, DRIVE_M_S / 15e-3)


def test_measured_robots_are_those_published():
    real, row = measured(), measured_row(1.0)
    assert len(real.motion.turn_rad_s) == 20
    assert row["drive_over_turn_mm_rad"] == pytest.approx(15.2, abs=0.05)
    assert (real.motion.drive_m_s / real.motion.turn_rad_s).argmax() == HARDLY_MOVES
    assert measured_row(0.5)["least_mm_rad"] == pytest.approx(0.5 * row["least_mm_rad"])
    assert 0.02 < np.median(real.drive_error) < np.median(real.turn_error) < 0.2


def test_errors_of_means_count_correlation_and_drift():
    random = np.random.default_rng(1)
    alone, drift, correlated = [], [], []
    for _ in range(300):
        noise = random.normal(size=51)
        follows = np.array([noise[:k].sum() for k in range(51)]) * 0.3
        for found, trials in (
            (alone, noise), (drift, noise + np.linspace(0, 6, 51)), (correlated, follows)
        ):  # fmt: skip
            found.append(batch_medians(10.0 + trials)[1])
    assert np.sqrt(np.mean(np.square(alone))) == pytest.approx(
        1.2533 * 51**-0.5, rel=0.15
    )  # of a median
    assert np.median(drift) > 4 * np.median(alone)
    assert np.median(correlated) > 2 * np.median(alone)
    assert batch_medians(np.repeat([1.0, 2.0, 3.0, 4.0, 5.0], 4))[1] == pytest.approx(
        np.std([1, 2, 3, 4, 5], ddof=1) / BATCHES**0.5
    )


def test_a_variant_predicts_the_turning_from_the_driving():
    row = variant_row(SHOWN, ALIKE)
    assert row["drive_over_turn_mm_rad"] == pytest.approx(15.0)
    assert row["forward_over_backward"] == pytest.approx(1.1 / 0.9)
    assert row["robots"] == 19
    real = measured().motion
    mine = np.arange(20) != HARDLY_MOVES
    error = np.log(real.drive_m_s / 15e-3 / real.turn_rad_s)[mine]
    assert row["turn_error"] == pytest.approx(np.sqrt(np.mean(error**2)))
    assert row["turn_ratio"] == pytest.approx(np.exp(error.mean()))
    both = np.hypot(measured().drive_error, measured().turn_error)[mine]
    assert row["data_error"] == pytest.approx(np.sqrt(np.mean(both**2)), rel=0.05)
    robots = robot_rows(ALIKE)
    assert [r["robot"] for r in robots] == list(range(1, 21))
    near = [r["simulated_deg_s"] / np.degrees(r["drive_mm_s"] / 15.0) for r in robots]
    assert near == pytest.approx([1.0] * 20)
    assert draw(robots).axes


def test_speeds_out_of_reach_predict_nothing():
    slow = ALIKE._replace(forward_m_s=0.2 * DRIVE_M_S, backward_m_s=0.2 * DRIVE_M_S)
    row = variant_row(SHOWN, slow)
    assert row["robots"] < 10
    assert row["drive_over_turn_mm_rad"] is None


@pytest.mark.slow
def test_turning_is_within_the_range_of_real_robots(motor_fmu):
    """The row of docs/validation.md."""
    config, fmu = find_preset("droplet").config(), MotorFmu(motor_fmu)
    row = variant_row(SHOWN, simulated(config, fmu, SHOWN.mu, SHOWN.spin_up_s))
    least, largest = (
        measured_row(SHOWN.unit_mm)[f"{name}_mm_rad"] for name in ("least", "largest")
    )
    assert least < row["drive_over_turn_mm_rad"] < largest

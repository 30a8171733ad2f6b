"""Droplets: the measured numbers, and what is concluded of a simulation."""

import numpy as np
import pytest

from cosim.fmi.motor import MotorFmu
from cosim.machine.validation.droplets import (
    HARDLY_MOVES,
    SHOWN,
    UNBALANCES_KG_M,
    Motion,
    draw,
    measured,
    measured_row,
    robot_rows,
    simulated,
    variant_row,
)
from cosim.model.preset import find_preset

# Simulated robots that drive by their unbalance, and turn by what they drive.
DRIVE_M_S = np.linspace(0.5e-3, 7e-3, len(UNBALANCES_KG_M))
ALIKE = Motion(DRIVE_M_S, DRIVE_M_S, DRIVE_M_S / 15e-3)


def test_measured_robots_are_those_published():
    real, row = measured(), measured_row()
    assert len(real.turn_rad_s) == 20
    ratio = [row[name] for name in ("drive_over_turn_mm_rad", "least_mm_rad", "largest_mm_rad")]
    assert ratio == pytest.approx([15.3, 11.8, 19.7], abs=0.05)
    assert (real.drive_m_s / real.turn_rad_s).argmax() == HARDLY_MOVES


def test_a_variant_predicts_the_turning_from_the_driving():
    row = variant_row(SHOWN, ALIKE)
    assert row["drive_over_turn_mm_rad"] == pytest.approx(15.0)
    assert row["forward_over_backward"] == pytest.approx(1.0)
    assert (row["robots"], row["others_within"]) == (19, 10)
    assert row["turn_error"] == pytest.approx(0.155, abs=0.005)
    robots = list(robot_rows(ALIKE))
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
    config = find_preset("droplet").config()
    row = variant_row(SHOWN, simulated(config, MotorFmu(motor_fmu), SHOWN))
    assert row["drive_over_turn_mm_rad"] == pytest.approx(17.7, abs=0.3)

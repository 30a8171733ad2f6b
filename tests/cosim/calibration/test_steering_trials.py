"""Steering in the co-simulation: straight lines under noise and unknown motor phases, stops."""

import json
import math

import numpy as np
import pytest

from benchmarks import __main__ as benchmarks
from benchmarks import steering
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig
from tests.references.lines import drive_line


def check(runs, speed_m_s, length_m):
    assert runs.path_error_m.max() < 3e-3
    assert np.rad2deg(runs.heading_error_rad.max()) < 5.0
    assert runs.overshoot_m.max() < 2e-3
    assert runs.duration_s.max() < 1.05 * length_m / speed_m_s + 0.3


def test_drives_straight_forwards_and_backwards(motor_fmu):
    config = CoSimConfig()
    runs = drive_line(MotorFmu(motor_fmu), config, 0.03, 0.0, 4, seed=1)
    check(runs, config.steering.drive_speed_m_s, 0.03)


def test_turns_and_stops_without_overshoot(motor_fmu):
    runs = drive_line(MotorFmu(motor_fmu), CoSimConfig(), 0.01, math.radians(45.0), 4, seed=1)
    assert np.rad2deg(runs.turn_overshoot_rad.max()) < 3.0
    assert runs.overshoot_m.max() < 2e-3
    assert runs.final_error_m.max() < 2e-3
    assert runs.duration_s.max() < 8.0


def test_benchmark_prints_json(monkeypatch, command):
    monkeypatch.setattr(steering, "LINE_M", 0.005)
    monkeypatch.setattr(steering, "MOVES", {"straight": (1.0, 0.0)})
    done = command(benchmarks, "steering", "--seeds", 2, "--json", "--controllers", "kept")
    rows = json.loads(done.stdout.splitlines()[-1])["rows"]
    assert [row["case"] for row in rows] == ["line of 20 cm", "straight"]
    assert rows[1]["duration_s"] < 4.0


@pytest.mark.slow
def test_straight_line_of_20_cm_over_20_seeds(motor_fmu):
    config = CoSimConfig()
    runs = drive_line(MotorFmu(motor_fmu), config, 0.2, 0.0, 20, seed=0)
    check(runs, config.steering.drive_speed_m_s, 0.2)

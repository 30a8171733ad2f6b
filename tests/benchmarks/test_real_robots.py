"""Simulated and published: what is measured, how it is kept, what the rows say."""

import cmath
import math

import numpy as np
import pytest

from benchmarks import real_robots
from benchmarks.published.driving import (
    PARAMETERS,
    MeasuredSpeed,
    closed_form,
    drive_by_the_clock,
    measured_speed,
)
from benchmarks.published.points import PATHS, SPEEDS, Legs, polygon, step_um
from benchmarks.published.rows import rows_of
from cosim.fmi.motor import MotorFmu
from cosim.machine.platform.motion import net_speed, robot_platform
from cosim.model.config import CoSimConfig


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.name)
def test_paths_lead_to_where_they_are_meant_to(path):
    """What the parts of a path add up to, if each is exact."""
    where, heading = 0j, 0.0
    for manoeuvre, amount in path.legs:
        if manoeuvre in {"left_turn", "right_turn"}:
            heading += amount if manoeuvre == "left_turn" else -amount
        else:
            where += (1.0 if manoeuvre == "forwards" else -1.0) * cmath.rect(amount, heading)
    assert (where.real, where.imag, heading) == pytest.approx(path.meant)


def test_speeds_are_those_of_the_platform_in_phase(motor_fmu):
    found = measured_speed(CoSimConfig(), MotorFmu(motor_fmu), "forwards", 850.0, 1)
    assert found.mean == found.least == found.largest
    assert found.mean == pytest.approx(net_speed(robot_platform(), 850.0), rel=0.25)


def test_paths_by_the_clock_end_about_where_they_are_meant_to(motor_fmu):
    path: Legs = (("forwards", 4e-3), ("left_turn", 0.2), ("backwards", 4e-3))
    config, fmu = CoSimConfig(), MotorFmu(motor_fmu)
    ends = drive_by_the_clock(config, fmu, path, 3, seed=1, dithered=True)
    meant = (4e-3 * (1.0 - math.cos(0.2)), -4e-3 * math.sin(0.2))
    assert ends.shape == (3, 3)
    assert np.ptp(ends, axis=0).min() > 0.0  # every robot has noise and a phase of its own
    assert np.abs(ends[:, :2] - meant).max() < 2e-3
    assert ends[:, 2].mean() == pytest.approx(0.2, abs=0.1)


def test_closed_form_sensitivities_are_of_robots_on_the_floor():
    config = CoSimConfig()
    found = closed_form(config, 900.0)
    assert found["mu"] < 0.0 < found["m r"] < found["motor speed"]
    assert found["mass_kg"] == pytest.approx(-found["m r"], rel=0.01)  # but for the eccentric mass
    assert closed_form(config, 1200.0) == closed_form(config, 500.0) == {}


def test_rows_compare_and_explain():
    """Speeds of twice those published, and paths that end 3 mm and 4 mm off."""
    speeds = {p: MeasuredSpeed(2e-3 * (p.value or 1.0), 0.0, 1.0, 0.5) for p in SPEEDS}
    slopes: dict[str, float | None] = dict.fromkeys((*PARAMETERS, "motor speed"), 2.0)
    slopes |= {"mu": -1.0, "mass_kg": 0.5}
    points = [p for p in SPEEDS if p.preset == "icra2006" and p.value is not None]
    off = np.array([[3e-3, 4e-3, 0.1]] * 2)
    found = rows_of(
        speeds,
        {p: (slopes, {"mu": -3.0}) for p in points},
        [(path, True, (path.meant + off).tolist()) for path in PATHS],
    )
    speed = found["speeds"][0]
    assert (speed["simulated"], speed["published"], speed["ratio"]) == (1.0, 0.5, 2.0)
    assert (
        speed["published_step_um"]
        == pytest.approx(step_um(0.5, 1050.0))
        == pytest.approx(2.992, 1e-3)
    )
    rows = {row["parameter"]: row for row in found["sensitivities"][: len(PARAMETERS) + 1]}
    assert rows["mu"]["explains"] == pytest.approx(0.8)  # twice the friction: half the speed
    assert rows["foot_radius_m"]["explains"] == pytest.approx(
        rows["foot_radius_m"]["value"] / 2**0.5
    )
    assert rows["mass_kg"]["explains"] is None  # four times as much
    assert rows["mu"]["platform"] == -3.0
    by_speed = {(row["preset"], row["motor_speed_rad_s"]): row for row in found["reversals"]}
    assert by_speed["icra2006", 1200.0]["published"] is None
    assert found["paths"][0]["off_mm"] == pytest.approx(5.0)


@pytest.mark.long
def test_what_was_measured_is_found_again(monkeypatch, tmp_path):
    """The whole benchmark on one speed and one small path, twice."""
    monkeypatch.setattr(real_robots, "SPEEDS", (SPEEDS[-1],))
    monkeypatch.setattr(real_robots, "PATHS", (polygon(3, 1.0, (1.0,), None),))
    monkeypatch.setattr(real_robots, "VERSION", str(tmp_path))  # of which nothing is kept yet
    options = real_robots.Options(quick=True, figure=tmp_path / "new" / "droplets.png")
    first = real_robots.measure(options)
    assert options.figure.exists()

    def refused(*_: object, **__: object):
        raise AssertionError("measured again")

    monkeypatch.setattr(real_robots.Measurement, "result", refused)
    assert real_robots.measure(options) == first

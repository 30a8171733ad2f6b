"""Simulated and published: what is measured, how it is kept, what the tables say."""

import cmath
import json
import math

import numpy as np
import pytest

from cosim.fmi.motor import MotorFmu
from cosim.machine.platform.motion import net_speed, robot_platform
from cosim.machine.validation import validate as measurement
from cosim.machine.validation.driving import (
    PARAMETERS,
    MeasuredSpeed,
    closed_form,
    drive_by_the_clock,
    measured_speed,
)
from cosim.machine.validation.published import PATHS, SPEEDS, Legs, polygon, step_um
from cosim.machine.validation.report import ValidationReport, report_of, text_of
from cosim.machine.validation.validate import QUICK, validate
from cosim.model.config import CoSimConfig


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.name)
def test_paths_lead_to_where_they_are_meant_to(path):
    """What the parts of a path add up to, if each is exact."""
    where, heading = 0j, 0.0
    for manoeuvre, amount in path.legs:
        if manoeuvre in {"left", "right"}:
            heading += amount if manoeuvre == "left" else -amount
        else:
            where += (1.0 if manoeuvre == "forwards" else -1.0) * cmath.rect(amount, heading)
    assert (where.real, where.imag, heading) == pytest.approx(path.meant)


def test_speeds_are_those_of_the_platform_in_phase(motor_fmu):
    found = measured_speed(CoSimConfig(), MotorFmu(motor_fmu), "forwards", 850.0, 1)
    assert found.mean == found.least == found.largest
    assert found.mean == pytest.approx(net_speed(robot_platform(), 850.0), rel=0.25)


def test_paths_by_the_clock_end_about_where_they_are_meant_to(motor_fmu):
    path: Legs = (("forwards", 4e-3), ("left", 0.2), ("backwards", 4e-3))
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


@pytest.fixture
def made_up() -> ValidationReport:
    """Speeds of twice those published, and paths that end 3 mm and 4 mm off."""
    speeds = {p: MeasuredSpeed(2e-3 * (p.value or 1.0), 0.0, 1.0, 0.5) for p in SPEEDS}
    slopes: dict[str, float | None] = dict.fromkeys((*PARAMETERS, "motor speed"), 2.0)
    slopes |= {"mu": -1.0, "mass_kg": 0.5}
    points = [p for p in SPEEDS if p.preset == "icra2006" and p.value is not None]
    off = np.array([[3e-3, 4e-3, 0.1]] * 2)
    return report_of(
        speeds,
        {p: (slopes, {"mu": -3.0}) for p in points},
        [(path, True, (path.meant + off).tolist()) for path in PATHS],
        QUICK,
        seed=0,
    )


def test_tables_compare_and_explain(made_up):
    report = made_up
    speed = report.speeds[0]
    assert (speed["simulated"], speed["published"], speed["ratio"]) == (1.0, 0.5, 2.0)
    assert (
        speed["published_step_um"]
        == pytest.approx(step_um(0.5, 1050.0))
        == pytest.approx(2.992, 1e-3)
    )
    rows = {row["parameter"]: row for row in report.sensitivities[: len(PARAMETERS) + 1]}
    assert rows["mu"]["explains"] == pytest.approx(0.8)  # twice the friction: half the speed
    assert rows["foot_radius_m"]["explains"] == pytest.approx(
        rows["foot_radius_m"]["value"] / 2**0.5
    )
    assert rows["mass_kg"]["explains"] is None  # four times as much
    assert rows["mu"]["platform"] == -3.0
    by_speed = {(row["preset"], row["motor_speed_rad_s"]): row for row in report.reversals}
    assert by_speed["icra2006", 1200.0]["published"] is None
    assert report.paths[0]["off_mm"] == pytest.approx(5.0)
    text = text_of(report)
    assert "| icra2006 | forwards | 1050 | 1.00 (0.00 to 1000.00) mm/s | 50% | 0.5 | 2.00 |" in text
    assert all(f"- {point.source}" in text for point in (*SPEEDS, *PATHS))
    assert "recalled" in text


@pytest.mark.long
def test_what_was_measured_is_found_again(motor_fmu, monkeypatch, tmp_path, command):
    """The whole command on one speed and one small path, twice."""
    monkeypatch.setattr(measurement, "SPEEDS", (SPEEDS[-1],))
    monkeypatch.setattr(measurement, "PATHS", (polygon(3, 1.0, (1.0,), None),))
    monkeypatch.setattr(measurement, "VERSION", str(tmp_path))  # of which nothing is kept yet
    counts: list[float] = []

    def told(task: str, done: float, total: float | None, state: str = "") -> None:
        counts.append(done)

    first = validate(motor_fmu, QUICK, progress=told)
    assert len(first.speeds) + len(first.paths) in counts

    def refused(*_: object, **__: object):
        raise AssertionError("measured again")

    monkeypatch.setattr(measurement.Measurement, "result", refused)
    fmu = ("--motor-fmu", motor_fmu)
    done = command("validate", "--quick", "--json", "--out", tmp_path, *fmu)
    assert done.returncode == 0, done.stderr
    printed = json.loads(done.stdout.splitlines()[-1])
    assert printed == json.loads((tmp_path / "validation.json").read_text("utf-8"))
    assert printed["speeds"][0]["certainty"] == "recalled"
    assert {path.name for path in tmp_path.iterdir()} == {
        "validation.json",
        "validation.md",
        "droplets.png",
    }

"""Calibration: real trials give a map, the map gives motor speeds, hopping is refused."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cosim.base.errors import UserError
from cosim.calibration.measuring import calibrated, digest, find_calibration, shares_of
from cosim.calibration.report import draw
from cosim.calibration.speed_map import DRIVES, TURNS, Calibration, load_calibration
from cosim.calibration.trial import Trial, heading_angles
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig
from cosim.model.params import STEERING, TABLE_I, TIMING
from cosim.model.world import World


@pytest.fixture(scope="module")
def calibration(motor_fmu) -> Calibration:
    return find_calibration(CoSimConfig(), motor_fmu)


@pytest.mark.long
@pytest.mark.parametrize("name", [*DRIVES[:2], *TURNS])
def test_faster_motors_move_faster_and_repeatably(calibration, name):
    curve = calibration.curve(name)
    assert (np.diff(curve.omega_rad_s) > 0.0).all()
    assert (np.diff(curve.mean) > 0.0).all()
    driving = curve.mean > 0.3 * curve.mean[-1]
    assert (curve.scatter[driving] < 0.05 * curve.mean[driving]).all()


@pytest.mark.long
@pytest.mark.parametrize(("manoeuvre", "ratio"), [("forwards", 2.0), ("left_turn", 4.0)])
def test_dither_removes_what_the_phases_do(calibration, manoeuvre, ratio):
    without = calibration.curve(manoeuvre, dithered=False)
    assert without.scatter.mean() > ratio * calibration.curve(manoeuvre).scatter.mean()


def test_the_panel_of_phases_is_of_the_speed_that_the_machine_drives_at(calibration):
    speeds = np.unique(calibration.set_speed_rad_s[~calibration.dithered])
    for driven in (speeds[0] + 1.0, speeds[-1] - 1.0):
        axes: Any = draw(calibration, "", driven).axes[3]
        (nearest,) = (speed for speed in speeds if abs(speed - driven) == 1.0)
        assert axes.get_title() == f"{nearest:.0f} rad/s"
        lines = [
            (name, place, dithered)
            for name, place in (("forwards", 0), ("left_turn", 4))
            for dithered in (True, False)
        ]
        for line, (name, place, dithered) in zip(axes.lines, lines, strict=True):
            assert line.get_label() == f"{name}, {'with' if dithered else 'without'} dither"
            rows = zip(
                calibration.primitive, calibration.set_speed_rad_s, calibration.dithered,
                calibration.difference_rad_s, strict=True,
            )  # fmt: skip
            chosen = [row == (place, nearest, dithered, 0.0) for row in rows]
            columns = calibration.phase_rad[chosen], calibration.yaw_rate_rad_s[chosen]
            assert len(columns[0]) > 1
            np.testing.assert_allclose(line.get_xydata(), np.rad2deg(columns).T)


def test_hop_free_speed_is_below_lift_off_and_met(calibration):
    assert 1000.0 < calibration.hop_free_rad_s < 1151.0
    for name in calibration.primitives:
        curve = calibration.curve(name)
        assert (curve.airborne_share[curve.omega_rad_s <= calibration.hop_free_rad_s] == 0.0).all()


def test_default_motor_speeds_are_the_calibrated_ones(calibration):
    assert calibration.primitives == [*DRIVES[:2], *TURNS]
    found = calibration.resolved(CoSimConfig()).steering
    assert found[:-2] == pytest.approx(STEERING[:-2], rel=0.01)
    assert found[-2:] == STEERING[-2:]  # what a file states: shares, and what each drive does


@pytest.mark.parametrize(
    ("name", "speed_mm_s", "yaw_deg_s"),
    [("forwards", 3.0, 0.0), ("backwards", -3.0, 0.0), ("right_turn", 0.0, -9.0)],
)
def test_motor_speeds_realise_a_motion(calibration, motor_fmu, name, speed_mm_s, yaw_deg_s):
    """Driven in the co-simulation with a noise that the calibration has not seen."""
    value = abs(1e-3 * speed_mm_s + np.deg2rad(yaw_deg_s))
    d, e = calibration.motor_speed(name, value) * np.array(shares_of(CoSimConfig(), name))
    sign = -1.0 if speed_mm_s == 0.0 else 1.0
    dither = STEERING.dither_rad_s if d + e == 0.0 or speed_mm_s == 0.0 else 0.0
    with Trial(MotorFmu(motor_fmu), CoSimConfig(), np.zeros(3), np.random.SeedSequence(9)) as trial:
        trial.set_motors(np.array([d, e]))
        trial.advance(2000)
        poses = []
        for change in (dither, -dither) * 2:
            trial.set_motors(np.array([d + sign * change, e + change]))
            samples = trial.advance(157)
            poses.append(np.concatenate([samples.position, samples.quaternion], axis=2))
    pose = np.concatenate(poses)
    angles = heading_angles(pose[:, :, 3:7])
    time_s = (len(pose) - 1) * TIMING.control_period_s
    moved, middle = np.diff(pose[:, :, :2], axis=0), angles[:-1]
    forward = (np.cos(middle) * moved[..., 0] + np.sin(middle) * moved[..., 1]).sum(axis=0) / time_s
    yaw = (angles[-1] - angles[0]) / time_s
    if speed_mm_s:
        assert 1e3 * forward == pytest.approx(speed_mm_s, rel=0.05)
    assert np.rad2deg(yaw).mean() == pytest.approx(yaw_deg_s, rel=0.1, abs=0.3)


def test_speeds_that_need_hopping_are_refused_or_the_largest_possible(calibration):
    fast = CoSimConfig(steering=STEERING._replace(drive_speed_m_s=0.006))
    with pytest.raises(UserError, match=r"6 mm/s .* largest .* 4\.\d\d mm/s"):
        calibration.resolved(fast)
    wrong = replace(calibration, yaw_rate_rad_s=-calibration.yaw_rate_rad_s)
    with pytest.raises(UserError, match=r"diameter_m = 0\.05 hop at every .* turns them"):
        wrong.resolved(CoSimConfig())
    eager = CoSimConfig(steering=STEERING._replace(turn_rate_rad_s=9.0))
    turn = calibration.resolved(eager).steering.turn_speed_rad_s
    assert turn == pytest.approx(calibration.hop_free_rad_s, rel=0.01)


def test_another_desired_speed_needs_no_new_calibration(calibration, motor_fmu):
    slow = CoSimConfig(steering=STEERING._replace(drive_speed_m_s=0.002))
    assert digest(slow, motor_fmu) == digest(CoSimConfig(), motor_fmu)
    found = calibrated(slow, motor_fmu).steering
    assert found.forward_speed_rad_s < 850.0


def test_another_fmu_needs_a_new_calibration(motor_fmu, tmp_path):
    """Other parameters: tests/cosim/model/test_config_fields.py."""
    other_fmu = tmp_path / "other.fmu"
    other_fmu.write_bytes(motor_fmu.read_bytes() + b"\0")
    assert digest(CoSimConfig(), other_fmu) != digest(CoSimConfig(), motor_fmu)


def test_damaged_files_are_refused(calibration, tmp_path):
    path = tmp_path / "calibration.npz"
    with pytest.raises(UserError, match="no such calibration"):
        load_calibration(path)
    calibration.save(path)
    assert np.array_equal(load_calibration(path).forward_m_s, calibration.forward_m_s)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(UserError, match="not a calibration or damaged"):
        load_calibration(path)


def test_command_writes_map_and_plot(calibration, command, tmp_path):
    done = command("calibrate", "--out", tmp_path / "c", "--json")
    report = json.loads(done.stdout.splitlines()[-1])
    assert report["hop_free_rad_s"] == calibration.hop_free_rad_s
    assert report == json.loads((tmp_path / "c" / "calibration.json").read_text())
    assert (tmp_path / "c" / "calibration.png").read_bytes().startswith(b"\x89PNG")
    written = load_calibration(tmp_path / "c" / "calibration.npz")
    assert np.array_equal(written.forward_m_s, calibration.forward_m_s)


@pytest.mark.slow
@pytest.mark.parametrize("mu", [0.1, 0.2])
def test_friction_changes_neither_speed_nor_turn_rate(motor_fmu, mu):
    from tests.references.lines import drive_line

    def seconds(of_mu: float, length_m: float, turn_deg: float) -> float:
        config = CoSimConfig(robot=TABLE_I._replace(mu=of_mu))
        config = calibrated(config, motor_fmu)
        fmu, angle_rad = MotorFmu(motor_fmu), np.deg2rad(turn_deg)
        return drive_line(fmu, config, length_m, angle_rad, 6, 0).duration_s.mean()

    there, here = seconds(TABLE_I.mu, 0.05, 0.0), seconds(mu, 0.05, 0.0)
    assert here == pytest.approx(there, rel=0.03)
    # the path after the turn is the same in both, so that the difference is turning
    there, here = (seconds(m, 0.01, 85.0) - seconds(m, 0.01, 30.0) for m in (TABLE_I.mu, mu))
    assert here == pytest.approx(there, rel=0.08)


@pytest.mark.long
def test_bouncing_robots_are_steered_below_hopping(motor_fmu):
    """With a restitution of 0.7 faster motors are slower: the same speed has two motor speeds."""
    config = CoSimConfig().in_world(World(restitution=0.7))
    steering = calibrated(config, motor_fmu, slower=True).steering
    drives = steering.turn_speed_rad_s, steering.forward_speed_rad_s, steering.backward_speed_rad_s
    assert max(drives) <= steering.max_speed_rad_s < config.lift_off_rad_s

"""The 1-DOF platform against its table, an independent time integration and its own limits."""

import itertools
import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.machine.platform import motion as platform
from cosim.machine.platform.motion import POINTS_PER_CYCLE, PlatformResult, robot_platform
from cosim.model.params import FIG_3, TABLE_I, TABLE_II
from cosim.physics import stroke

# mu: omega_c, omega_net, then mm/s at 700 to 1100 rad/s, from an integration with small steps.
TABLE = {
    0.1: (363.0, 475.0, 1.29, 2.09, 2.99, 3.94, 4.92),
    0.15: (443.0, 568.0, 0.70, 1.57, 2.51, 3.50, 4.51),
    0.2: (510.0, 642.0, 0.17, 0.90, 1.87, 2.90, 3.95),
    0.3: (617.0, 751.0, 0.0, 0.11, 0.79, 1.73, 2.78),
    0.4: (702.0, 830.0, 0.0, 0.0, 0.22, 0.97, 1.95),
}
TABLE_ROUNDING = 0.0075  # mm/s: the table has two digits, and its integration an error of its own
friction = st.floats(0.05, 0.6)


def with_friction(mu: float) -> platform.Platform:
    return robot_platform(TABLE_I._replace(mu=mu))


@pytest.mark.parametrize("mu", TABLE)
def test_table_of_thresholds_and_net_speeds(mu):
    slip, drift, *speeds = TABLE[mu]
    assert platform.slip_speed(with_friction(mu)) == pytest.approx(slip, abs=0.5)
    assert platform.drift_speed(with_friction(mu)) == pytest.approx(drift, abs=0.5)
    found = [1e3 * platform.net_speed(with_friction(mu), w) for w in range(700, 1101, 100)]
    assert found == pytest.approx(speeds, rel=0.02, abs=TABLE_ROUNDING)


@given(friction)
def test_below_slip_speed_nothing_moves(mu):
    body = with_friction(mu)
    omega = 0.999 * platform.slip_speed(body)
    assert platform.strokes(body, omega, 5) == []
    assert platform.net_speed(body, omega) == 0.0
    assert not platform.trajectory(body, omega, np.linspace(0.0, 30.0, 50)).any()


@given(friction, st.floats(0.001, 0.999))
def test_between_slip_and_drift_speed_both_strokes_are_mirror_images(mu, share):
    body = with_friction(mu)
    slip, drift = platform.slip_speed(body), platform.drift_speed(body)
    omega = slip + share * (drift - slip)
    forwards, backwards = platform.strokes(body, omega, 3)[-2:]
    assert forwards.direction == -backwards.direction
    assert forwards.stop - forwards.start == pytest.approx(backwards.stop - backwards.start)
    # Zero to rounding: a stroke is some 1e-5 m long.
    assert abs(platform.net_displacement(body, omega)) < 1e-19


@given(friction, st.floats(0.001, 0.999))
def test_above_drift_speed_the_motion_is_along_plus_y(mu, share):
    body = with_friction(mu)
    drift, top = platform.drift_speed(body), platform.lift_off_speed(body)
    assert platform.net_displacement(body, drift + share * (top - drift)) > 0.0


@given(friction, st.floats(0.01, 0.99), st.floats(0.0, 30.0))
def test_strokes_start_and_end_at_rest_and_never_overlap(mu, share, turns):
    body = with_friction(mu)
    omega = platform.slip_speed(body) * (1.0 - share) + platform.lift_off_speed(body) * share
    alpha, s = math.atan(mu), (platform.slip_speed(body) / omega) ** 2
    found = platform.strokes(body, omega, 1 + int(turns))
    for now, after in itertools.pairwise(found):
        assert now.start < now.stop <= after.start
        assert stroke.speed(now.direction, alpha, s, now.start, now.start) == 0.0
        end = stroke.speed(now.direction, alpha, s, now.start, now.stop)
        middle = stroke.speed(now.direction, alpha, s, now.start, (now.start + now.stop) / 2.0)
        assert end == pytest.approx(0.0, abs=1e-12)
        assert middle * now.direction > 0.0


def test_trajectory_is_smooth_and_repeats_with_the_net_displacement():
    body = robot_platform()
    theta = np.linspace(0.0, 20.0 * math.pi, 20_001)
    y = platform.trajectory(body, 900.0, theta)
    assert np.abs(np.diff(y)).max() < 1e-7
    step = platform.net_displacement(body, 900.0)
    assert y[-1] - y[-2001] == pytest.approx(step, rel=1e-9)


def test_the_platform_like_the_printed_one_steps_by_its_printed_length():
    body = platform.FIG_3_PLATFORM
    assert 1e3 * platform.net_displacement(body, FIG_3.omega) == pytest.approx(0.29, abs=0.005)


def test_command_writes_its_table_and_motions(tmp_path, command):
    out = tmp_path / "platform.npz"
    done = command("platform", "--out", out, "--cycles", 3, "--json")
    last = json.loads(done.stdout.splitlines()[-1])
    assert 1e3 * last["table_net_speed_m_s"][1][2] == pytest.approx(2.504, abs=1e-3)
    result = PlatformResult.load(out)
    assert result.table.net_speed_m_s.tolist() == last["table_net_speed_m_s"]
    assert result.fig_3.position_m.shape == (3 * POINTS_PER_CYCLE + 1,)


def test_the_command_is_about_the_machine_and_its_motors(tmp_path, command):
    (tmp_path / "heavy.toml").write_text("[body]\nmass_kg = 0.06\n[motor]\nm = 4e-4\nr = 2e-3\n")
    options = ("--preset", tmp_path / "heavy.toml", "--omega", 500, "--out", tmp_path / "p.npz")
    done = command("platform", *options, "--json")
    robot = TABLE_I._replace(mass_kg=0.06, masses_included=True)  # as weighed
    moved = platform.net_displacement(
        robot_platform(robot, TABLE_II._replace(m=4e-4, r=2e-3)), 500.0
    )
    assert json.loads(done.stdout.splitlines()[-1])["table_ii_net_displacement_m"] == moved
    assert f"machine heavy: {1e6 * moved:.2f} µm per turn at 500 rad/s" in done.stdout


@pytest.mark.parametrize("omega", [0.0, -900.0, 1152.0])
def test_speeds_beyond_the_model_are_refused(omega):
    with pytest.raises(platform.UserError, match="choose one between 0 and 1151 rad/s"):
        platform.net_speed(robot_platform(), omega)

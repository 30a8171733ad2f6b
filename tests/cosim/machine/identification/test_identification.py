"""Robots identified from their tracks: the simulation of many, noise, reading, and the command."""

import csv
import hashlib
import json
import math
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cosim.base.arguments import ConfigError
from cosim.base.errors import FileError, UserError
from cosim.calibration.trial import Trial, heading_angles
from cosim.fmi.motor import MotorFmu
from cosim.machine.identification.fit import MOST_WIDENING, QUANTILE, Fit, _widened, unidentifiable
from cosim.machine.identification.noise import (
    LEAST_HEADING_RAD,
    LEAST_POSITION_M,
    Noise,
    deviance,
    likeliest_noise,
    residuals,
)
from cosim.machine.identification.plausible import require_plausible
from cosim.machine.identification.result import COLUMNS, Estimate, _mass_kg, _preset
from cosim.machine.identification.simulated import (
    Machine,
    Simulated,
    machine,
    parameters_of,
    tracks,
    usual_values,
)
from cosim.machine.identification.track import (
    FRAME_RATE_HZ,
    HOLD_S,
    SeenTrack,
    excitation,
    read_track,
    units,
    write_excitation,
)
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_I, TABLE_II, motors_of
from cosim.model.preset import find_preset
from cosim.model.world import Sensor, World
from cosim.onboard.camera import draw_sight
from cosim.physics.body_state import standing_state
from cosim.physics.mass import mass_of
from cosim.physics.properties import body_params
from docs.examples.draw_machine import machine as drawn
from fmus.build import cached_fmu
from tests.references.prescribed import STATE_SIZE, Drive, rig, trace_body

DT_S = 1e-5
UNITS = units(2)
NAMES = tuple(p.name for p in parameters_of(TABLE_I))
CAMERA = Sensor(FRAME_RATE_HZ, 50.0, 0.5, 1.0)


@pytest.mark.long
def test_robots_beside_each_other_move_as_each_alone():
    robots = [TABLE_I, TABLE_I._replace(com_x_m=5e-4, mu=0.3, com_height_m=0.018)]
    drive = Drive(-900.0, 930.0)
    speeds = np.tile([drive.omega_d, drive.omega_e], (101, 1))
    seen = tracks([Machine(robot) for robot in robots], speeds, 100, DT_S, 100)
    assert seen.shape == (2, 2, 3)
    for column, robot in enumerate(robots):
        state, trace = standing_state(robot, 0.0, 0.0, 0.0), np.empty((1, STATE_SIZE))
        trace_body(state, rig(robot, TABLE_II, DT_S), drive, 10_000, trace)
        # the phases of both differ by what 10 000 additions round
        np.testing.assert_allclose(seen[1, column, :2], trace[0, :2], rtol=1e-3)


@pytest.mark.long
def test_tracks_of_the_paper_s_kind_of_robot_keep_their_bits():
    machines = [
        Machine(TABLE_I._replace(
            mu=0.1 + 0.02 * k, com_height_m=0.014 + 2e-4 * k, com_x_m=1e-4 * k,
        ))
        for k in range(5)
    ]  # fmt: skip
    steps = 20.0 * np.random.default_rng(0).uniform(-1.0, 1.0, (60, 2))
    speeds = np.cumsum(steps, axis=0) + np.array([-900.0, 870.0])
    places = tracks(machines, speeds, 100, DT_S, 5)[..., :2]
    assert hashlib.sha256(places.tobytes()).hexdigest()[:16] == "66195cbeb2600701"


def test_only_the_ratio_of_mass_and_unbalance_shows():
    """A robot and motors of twice the mass move alike."""
    robot, speeds = find_preset("kilobot").config().robot, np.tile([700.0, -600.0], (301, 1))
    seen = []
    for factor in (1.0, 2.0):
        motor = TABLE_II._replace(m=factor * TABLE_II.m, J=factor * TABLE_II.J)
        heavy = Machine(robot._replace(mass_kg=factor * robot.mass_kg), (motor, motor))
        seen.append(tracks([heavy], speeds, 100, DT_S, 300)[-1])
    assert abs(seen[0][0, 2]) > 1e-3
    np.testing.assert_allclose(seen[0], seen[1], rtol=1e-4)


def test_a_stronger_motor_and_a_centre_of_mass_aside_are_mirrored():
    strong = TABLE_II._replace(r=1.1 * TABLE_II.r)
    aside = TABLE_I._replace(com_y_m=1e-3)
    machines = [
        Machine(aside, (strong, TABLE_II)),
        Machine(aside._replace(com_y_m=-1e-3), (TABLE_II, strong)),
    ]
    speeds = np.empty((301, 2, 2))
    speeds[:, :, 0], speeds[:, :, 1] = (-900.0, 950.0), (-950.0, 900.0)
    # the mirror image of a motor that turns one way turns the other way
    seen = tracks(machines, speeds, 100, DT_S, 300)[-1]
    assert abs(seen[0, 2]) > 1e-3
    np.testing.assert_allclose(seen[0] * [1, -1, -1], seen[1], rtol=1e-6)


def test_a_centre_of_mass_aside_is_that_of_the_payload_that_puts_it_there():
    assert mass_of(TABLE_I._replace(com_x_m=2e-3, com_y_m=-1e-3)).centre == (2e-3, -1e-3)
    assert mass_of(TABLE_I._replace(com_x_m=2e-3)).inertia == mass_of(TABLE_I).inertia
    with pytest.raises(ConfigError, match=r"falls over: .* \(20, 0\) mm"):
        CoSimConfig(robot=TABLE_I._replace(com_x_m=0.02))


def test_noise_is_found_and_makes_residuals_of_variance_one():
    rng, times = np.random.default_rng(0), np.arange(3000) / 30.0
    known = Noise(5e-4, math.radians(1.0), 1e-7, 1e-4)
    step_s = times[1]
    walk = rng.standard_normal((len(times), 3)).cumsum(axis=0) * np.sqrt(
        step_s * np.array([known.position_drift_m2_s] * 2 + [known.heading_drift_rad2_s])
    )
    frames = rng.standard_normal((len(times), 3))
    measured = walk + frames * [known.position_m, known.position_m, known.heading_rad]
    still = np.zeros_like(measured)
    found = likeliest_noise(times, measured, still)
    np.testing.assert_allclose(found[:2], known[:2], rtol=0.05)
    np.testing.assert_allclose(found[2:], known[2:], rtol=0.4)
    errors = residuals(times, measured, still[:, None], known)
    np.testing.assert_allclose(errors.var(axis=(0, 2)), 1.0, atol=0.1)
    for wrong in (known._replace(position_m=1e-3), known._replace(heading_drift_rad2_s=1e-2)):
        others = residuals(times, measured, still[:, None], wrong)
        assert deviance(times, others, wrong) > deviance(times, errors, known)
    # independent from frame to frame
    assert abs(np.mean(errors[1:] * errors[:-1])) < 0.03


def test_a_camera_without_noise_does_not_make_the_simulation_exact():
    times = np.arange(100) / 30.0
    found = likeliest_noise(times, np.zeros((100, 3)), np.zeros((100, 3)))
    assert found[:2] == (LEAST_POSITION_M, LEAST_HEADING_RAD)


def test_intervals_are_wider_where_the_model_is_not_linear():
    nothing, linear = np.empty((0, 3)), QUANTILE**2
    covariance = np.array([[1.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 1.0]])
    found = Fit(np.zeros(3), covariance, Noise(1.0, 1.0, 1.0, 1.0), nothing, nothing, 1)
    risen = np.array([[linear, math.nan], [linear / 4.0, linear], [9.0 * linear, -1.0]])
    wider = _widened(found, risen)
    np.testing.assert_allclose(wider.deviations, [1.0, 2.0, MOST_WIDENING])
    assert wider.covariance[0, 1] == pytest.approx(1.0)


def test_what_a_track_cannot_tell_is_said_by_name():
    parameters = parameters_of(TABLE_I)
    shares, spreads = np.diag(np.full(len(NAMES), 0.01)), [p.spread for p in parameters]
    pair = [NAMES.index("com_height_m"), NAMES.index("com_x_m")]
    shares[np.ix_(pair, pair)] = [[0.5, 0.495], [0.495, 0.5]]  # only their difference is known
    nothing = np.empty((0, 3))
    noise = Noise(1.0, 1.0, 1.0, 1.0)
    found = Fit(usual_values(), shares * np.outer(spreads, spreads), noise, nothing, nothing, 1)
    (words,) = unidentifiable(found, parameters)
    assert words == "com_height_m and com_x_m together: still 100% of the spread assumed before"


def test_the_excitation_can_be_read_as_what_a_track_was_driven_with(tmp_path):
    write_excitation(tmp_path / "drive.csv", excitation(CoSimConfig()))
    with (tmp_path / "drive.csv").open() as file:
        rows = [tuple(map(float, row.values())) for row in csv.DictReader(file)]
    times, commands = np.array(rows)[:, 0], np.array(rows)[:, 1:]
    set_points = SeenTrack(times, np.zeros((len(times), 3)), commands).set_points(1e-3)
    wanted = np.repeat(np.array(excitation(CoSimConfig())), round(1e3 * HOLD_S), axis=0)
    np.testing.assert_array_equal(set_points, wanted)
    assert (commands[-1] == 0.0).all()


def test_the_excitation_runs_each_motor_alone(tmp_path, command):
    command("identify-robot", "--excite", tmp_path / "drive.csv", "--preset", "droplet")
    with (tmp_path / "drive.csv").open() as file:
        header, *rows = csv.reader(file)
    assert header == ["time", "omega_1", "omega_2", "omega_3"]
    running = np.array(rows, dtype=float)[:, 1:] != 0.0
    assert {tuple(row) for row in running[running.sum(axis=1) == 1]} == set(map(tuple, np.eye(3)))


def test_the_excitation_of_a_motor_is_of_its_own_lift_off():
    config = find_preset("paper").config()
    motors = zip(config.robot.motors, (2.1e-4, 1.05e-4), strict=True)
    own = tuple(mount._replace(own=(("m", m),)) for mount, m in motors)
    robot = config.robot._replace(motors=own, masses_included=True)
    largest = np.abs(excitation(replace(config, robot=robot))).max(axis=0)
    assert largest[1] / largest[0] == pytest.approx(math.sqrt(2.0), rel=1e-3)


def write_track(path, track):
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(units(track.commands.shape[1]))
        writer.writerows(np.column_stack([track.times, track.poses, track.commands]).tolist())


GOOD = SeenTrack(
    np.arange(180) / 30.0, np.tile([0.1, 0.1, 0.0], (180, 1)), np.full((180, 2), 900.0)
)


def replaced(column, row, value):
    def change(lines):
        cells = lines[row].split(",")
        cells[column] = value
        lines[row] = ",".join(cells)
        return lines

    return change


def after(row, column, value):
    def change(lines):
        for each in range(row, len(lines)):
            lines = replaced(column, each, value)(lines)
        return lines

    return change


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda lines: [lines[0].replace("omega_2", "speed"), *lines[1:]], "line 1 has no .*omega"),
        (replaced(1, 7, "nan"), "line 8: x: 'nan' is not a number"),
        (replaced(3, 9, ""), "line 10: heading: the number is missing"),
        (replaced(0, 5, "0.1"), "line 6: its time is not after"),
        (lambda lines: lines[:20], "ends at line 20 after 19 frames"),
        (replaced(1, 30, "100.0"), "line 31: the pose jumps and returns"),
        (after(30, 1, "100.0"), "line 31: x and y jump"),
        (after(30, 3, "2.5"), "line 31: the heading jumps"),
        (replaced(5, 3, "60000"), "line 4: a motor speed beyond"),
        (lambda lines: [line.replace("900.0", "0") for line in lines], "drive the robot"),
        (lambda lines: [f"{line},x" for line in lines], "line 1 has two columns x; remove"),
        (lambda lines: [f"{line},X [m]" for line in lines], "line 1 has two columns x; remove"),
        (replaced(5, 7, "900.0,1"), "line 8: 7 cells for 6 columns; .* decimal points"),
        (replaced(0, 0, "time [ms]"), "line 1: time is in ms; give it in s"),
        (
            lambda lines: [line.replace(",", ";").replace(".", ",") for line in lines],
            "line 2: time: '0,0' is not a number; write a decimal point",
        ),
    ],
)
def test_what_is_no_track_is_refused_with_its_line(tmp_path, change, says):
    path = tmp_path / "track.csv"
    write_track(path, GOOD)
    path.write_text("\n".join(change(path.read_text().splitlines())))
    with pytest.raises(FileError, match=says):
        read_track(path)


@pytest.mark.parametrize("separator", [",", ", ", ";", "\t"])
@pytest.mark.parametrize("header", [list(UNITS), [f" {n.upper()} [{u}]" for n, u in UNITS.items()]])
def test_usual_forms_of_a_table_are_read_alike(tmp_path, header, separator):
    path = tmp_path / "track.csv"
    write_track(path, GOOD)
    rows = [header, *(line.split(",") for line in path.read_text().splitlines()[1:])]
    path.write_text("\n".join(separator.join(row) for row in rows))
    for read, written in zip(read_track(path), GOOD, strict=True):
        np.testing.assert_array_equal(read, written)


@pytest.mark.long
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(row=st.integers(1, 178), heading_rad=st.floats(-3.0, 3.0), noise_rad=st.floats(-0.3, 0.3))
def test_lines_that_are_no_frame_are_refused_by_what_they_are(
    tmp_path, row, heading_rad, noise_rad
):
    """Wherever they are, and whatever the robot's heading."""
    path, names = tmp_path / "track.csv", ",".join(UNITS)
    poses = np.column_stack([GOOD.poses[:, :2], np.full(len(GOOD.times), heading_rad)])
    write_track(path, GOOD._replace(poses=poses))
    good = path.read_text().splitlines()
    read_track(path)
    turned = good[row + 1].split(",")
    turned[3] = str(heading_rad + math.pi + noise_rad)
    time, *_, d, e = good[row + 1].split(",")
    numbered = [f"{k},{line.partition(',')[2]}" for k, line in enumerate(good[1:])]
    for lines, says in (
        (["# tracked", *good], "line 1 is a comment; leave comments out"),
        ([*good[:row], "# cut", *good[row:]], f"line {row + 1} is a comment"),
        ([names, ",".join(UNITS.values()), *good[1:]], "line 2 has no numbers; .* 'time \\[s\\]'"),
        ([line.replace(",", " ") for line in good], "line 1 has one column; separate cells by"),
        ([names, *numbered], "its frames are 1 s apart; give times in seconds"),
        (
            [*good[: row + 1], ",".join((time, "0", "0", "0.0", d, e)), *good[row + 2 :]],
            f"line {row + 2}: x, y and heading are 0: .* lost the robot",
        ),
        (
            [*good[: row + 1], ",".join(turned), *good[row + 2 :]],
            f"line {row + 2}: the pose jumps and returns in the next frame; .* turned by 180°",
        ),
    ):
        path.write_text("\n".join(lines))
        with pytest.raises(FileError, match=says):
            read_track(path)


def drive_of(times, commands, config):
    """Simulations of motors that reach their set points in 50 ms."""
    periods = 1e-3 * np.arange(round(1e3 * times[-1]) + 1)
    given = np.searchsorted(times, periods, side="right") - 1
    kernel = np.full(50, 0.02)
    smooth = [np.convolve(signal, kernel)[: len(periods)] for signal in commands[given].T]
    speeds = np.column_stack(smooth)
    return Simulated(speeds, speeds, times, config)


FAULTS = {
    "none": ((1, 1, 1), lambda omega: omega, None),
    "a camera's image": ((1, -1, -1), lambda omega: omega, "change the signs of y and heading"),
    "clockwise": ((1, 1, -1), lambda omega: omega, "change the sign of heading"),
    "y down": ((1, -1, 1), lambda omega: omega, "change the sign of y"),
    "backwards": ((1, 1, 1), lambda omega: -omega, "change the sign of all motor speeds"),
    "Hz": ((1, 1, 1), lambda omega: omega / (2.0 * np.pi), "in rad/s instead of Hz"),
    "without sign": ((1, 1, 1), np.abs, "motor speeds with their signs"),
    "still": ((0, 0, 0), lambda omega: omega, "check units, signs and order"),
}


@pytest.mark.long
@pytest.mark.parametrize("name", ["paper", "kilobot"])
@pytest.mark.parametrize("fault", FAULTS)
@settings(max_examples=2, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_tracks_that_no_such_machine_can_make_are_refused_with_their_fault(name, fault, seed):
    config = find_preset(name).config()
    drawn = np.random.default_rng(seed).uniform(-0.5, 0.5, len(parameters_of(config.robot)))
    truth = usual_values(config.robot)
    truth += drawn * [p.spread for p in parameters_of(config.robot)]
    times = np.arange(180) / 30.0
    rows = np.array(excitation(config))[[0, 1, 2, 4], :]
    commands = rows[(times / 1.5).astype(int)]
    poses = drive_of(times, commands, config).frames(truth[None])[:, 0]
    poses[:, :2] = poses[:, :2] @ [[np.cos(1.0), np.sin(1.0)], [-np.sin(1.0), np.cos(1.0)]]
    poses += [0.1, 0.1, 1.0]
    signs, change, says = FAULTS[fault]
    if name != "paper" and says:
        says = ""  # its two motors are so near each other that faults look alike
    track = SeenTrack(times, poses * signs, change(commands))
    drive = drive_of(times, track.commands, config)
    with pytest.raises(UserError, match=f"^t.csv: .*{says}") if fault != "none" else nullcontext():
        require_plausible("t.csv", track, drive)


@pytest.mark.long
def test_motors_that_keep_their_phase_are_refused_and_near_ones_named(caplog):
    times, config = np.arange(180) / 30.0, CoSimConfig()
    for other, known in ((920.0, False), (970.0, True), (1010.0, True)):
        commands = np.tile([900.0, -other], (180, 1))
        commands[120:] *= known  # a pause is no driving
        drive = drive_of(times, commands, config)
        poses = drive.frames(drive.usual[None])[:, 0]
        says = r"in 100% of the time .* less than 50 rad/s, .* --excite"
        with nullcontext() if known else pytest.raises(UserError, match=says):
            require_plausible("t.csv", SeenTrack(times, poses, commands), drive)
    (warning,) = caplog.messages
    assert "less than 100 rad/s, and their phase is a part of the motion" in warning


def test_a_robot_that_leaves_the_board_is_refused(command, tmp_path):
    write_track(tmp_path / "track.csv", GOOD)
    assert len(read_track(tmp_path / "track.csv", (0.16, 0.16)).times) == len(GOOD.times)
    for board_m in ((0.16, 0.09), (0.09, 0.16)):
        with pytest.raises(FileError, match="line 2: the robot has left the board"):
            read_track(tmp_path / "track.csv", board_m)
    board = "--board", 0.09, 0.16
    done = command("identify-robot", tmp_path / "track.csv", *board, "--out", tmp_path)
    assert (done.returncode, "has left the board" in done.stderr) == (2, True)


def observed(
    values: np.ndarray, sequence: Sequence[tuple[float, ...]], config: CoSimConfig | None = None
) -> SeenTrack:
    """The track of a known machine: co-simulated with its motors and speed noise, seen by a camera.

    Args:
        values: see `cosim.machine.identification.simulated`; all else is of the configuration.
        sequence: set points of the motors, each held for HOLD_S.
    """
    config = config or CoSimConfig()
    robot, motors = machine(values, config.robot, config.motor)
    config, seed = replace(config, robot=robot), np.random.SeedSequence(4)
    period_s = config.timing.control_period_s
    with Trial(MotorFmu(cached_fmu()), config, np.zeros(1), seed, motors=[motors]) as trial:
        places, turned = [trial.bodies[:2].T - trial.origins_m], [trial.bodies[3:7].T.copy()]
        for set_points in sequence:
            trial.set_motors(np.array(set_points))
            samples = trial.advance(round(HOLD_S / period_s))
            places.append(samples.position[:, 0, :2] - trial.origins_m)
            turned.append(samples.quaternion[:, 0])
    angles = heading_angles(np.concatenate(turned))
    frames = round(len(sequence) * HOLD_S * CAMERA.rate_hz) + 1
    times = np.arange(frames) / CAMERA.rate_hz
    looks, taken = period_s * np.arange(len(angles)), times - values[-1]
    poses = np.column_stack(
        [np.interp(taken, looks, s) for s in (*np.concatenate(places).T, angles)]
    )
    poses += draw_sight(CAMERA, np.random.default_rng(seed), frames)[:, :3]
    steps = np.minimum((times / HOLD_S + 1e-9).astype(int), len(sequence) - 1)
    return SeenTrack(times, poses, np.array(sequence)[steps])


@pytest.mark.long
def test_machines_are_simulated_with_their_restitution():
    world, drive = World(restitution=0.4), Drive(-1000.0, 1010.0)
    speeds = np.tile([drive.omega_d, drive.omega_e], (101, 1))
    config = replace(CoSimConfig(), world=world)
    times = np.array([0.0, 0.1])
    values = usual_values()
    values[-1] = 0.0  # of the camera's delay
    seen = Simulated(speeds, speeds, times, config).frames(values[None])[-1, 0]
    state, trace = standing_state(TABLE_I, 0.0, 0.0, 0.0), np.empty((1, STATE_SIZE))
    bouncing = rig(TABLE_I, TABLE_II, DT_S)
    bouncing = bouncing._replace(body=body_params(TABLE_I, TABLE_II, DT_S, world=world))
    trace_body(state, bouncing, drive, 10_000, trace)
    np.testing.assert_allclose(seen[:2], trace[0, :2], rtol=1e-3, atol=1e-7)
    ideal = Simulated(speeds, speeds, times, CoSimConfig()).frames(values[None])[-1, 0]
    assert np.abs(seen - ideal).max() > 1e-5


def test_a_machine_that_tips_over_is_refused_with_the_reason():
    """The other one, whose centre of mass is not between its feet, is simulated with it."""
    speeds, times = np.tile([-600.0, 650.0], (501, 1)), np.array([0.0, 0.1, 0.5])
    simulated = Simulated(speeds, speeds, times, CoSimConfig())
    values = np.tile(simulated.usual, (2, 1))
    values[1, NAMES.index("com_x_m")] = -0.03
    stands, falls = simulated.frames(values).swapaxes(0, 1)
    simulated.require_standing(stands)
    alone = simulated.frames(values[:1])[:, 0]
    np.testing.assert_array_equal(stands, alone)
    assert np.isfinite(falls).all()
    with pytest.raises(UserError, match=r"^machine paper tips over when it is simulated"):
        simulated.require_standing(falls)


FOOT = "[[foot]]\nplace_m = [{}, {}]\nmu = {}\n"
MACHINES = {
    "paper": "",
    "every foot has its own mu": "".join(
        FOOT.format(0.02 * math.cos(2.1 * k), 0.02 * math.sin(2.1 * k), 0.1 + 0.1 * k)
        for k in range(3)
    ),
    "two of four do": "[body]\nmu = 0.3\nheight_m = 0.02\n"
    + "".join(FOOT.format(x, y, 0.2) for x, y in ((0.01, 0.02), (-0.01, 0.02)))
    + "".join(FOOT.format(x, y, 0).replace("mu = 0\n", "") for x, y in ((0.0, -0.02), (0.02, 0))),
    "drawn": drawn(1),
}


@given(data=st.data(), name=st.sampled_from([*MACHINES, "droplet", "kilobot"]))
@settings(max_examples=40)
def test_what_is_identified_can_be_read(tmp_path_factory, data, name):
    folder = tmp_path_factory.mktemp("identified")
    (folder / "mine.toml").write_text(MACHINES.get(name, ""))
    preset = find_preset(folder / "mine.toml" if name in MACHINES else name)
    config = preset.config()
    times, still = np.arange(100) / 30.0, np.zeros((100, len(config.robot.motors)))
    track = SeenTrack(times, np.zeros((100, 3)), still)
    drive = Simulated(still, still, times, config)
    shares = [data.draw(st.floats(0.0, 1.0)) for _ in drive.parameters]
    low, high = drive.limits
    values = low + np.array(shares) * (high - low)
    for k, parameter in enumerate(drive.parameters):
        if parameter.name in ("com_x_m", "com_y_m"):
            values[k] = (
                0.1 * values[k]
            )  # a fit may end where the machine falls over: see `identify`
    noise, count = Noise(5e-4, 0.01, 1e-7, 1e-3), len(values)
    found = Fit(values, 1e-6 * np.eye(count), noise, still, track.poses, 1)
    _preset(track, "track.csv", preset, drive, found).save(folder / "robot.toml")
    robot = find_preset(folder / "robot.toml").config().robot
    expected, motors = machine(values, config.robot, config.motor)
    assert [foot.mu for foot in robot.feet] == [foot.mu for foot in expected.feet]
    assert robot.com_height_m == expected.com_height_m
    assert motors_of(robot, find_preset(folder / "robot.toml").config().motor) == motors
    assert robot.masses_included == expected.masses_included


@pytest.mark.parametrize(("rate_hz", "kept_hz"), [(2000.0, 1000.0), (60.0, 60.0)])
def test_the_preset_of_a_camera_that_loses_frames_can_be_read(tmp_path, rate_hz, kept_hz):
    times, still = np.arange(112) / rate_hz, np.zeros((100, 2))
    times = np.delete(times, np.arange(5, 101, 8)[:12])  # frames that the camera lost
    track = SeenTrack(times, np.zeros((100, 3)), still)
    drive, count = Simulated(still, still, times, CoSimConfig()), len(NAMES)
    noise = Noise(5e-4, 0.01, 1e-7, 1e-3)
    found = Fit(usual_values(), 1e-6 * np.eye(count), noise, still, track.poses, 1)
    _preset(track, "track.csv", find_preset("paper"), drive, found).save(tmp_path / "robot.toml")
    assert find_preset(tmp_path / "robot.toml").config().world.camera.rate_hz == kept_hz


def test_there_are_no_intervals_in_doubt():
    times, still = np.arange(100) / 30.0, np.zeros((100, 2))
    track = SeenTrack(times, np.zeros((100, 3)), still)
    drive, count = Simulated(still, still, times, CoSimConfig()), len(NAMES)
    noise, doubts = Noise(5e-4, 0.01, 1e-7, 1e-3), ("three frames are off",)
    found = Fit(usual_values(), 1e-6 * np.eye(count), noise, still, track.poses, 1, doubts)
    preset = _preset(track, "track.csv", find_preset("paper"), drive, found)
    assert preset.tree["mu"][1] == (
        "identified from track.csv: without an interval: three frames are off"
    )
    assert _mass_kg(drive, found)[1:] == (None, None)
    value, low, high = _mass_kg(drive, found._replace(doubts=()))
    assert low is not None
    assert high is not None
    assert 0.0 < low < value < high
    estimate = Estimate(
        name="mu", description="", value=0.1, low=None, high=None, identifiable=True, rises=()
    )
    assert COLUMNS[3].text(estimate) == "none"


@pytest.mark.slow
def test_a_robot_is_identified_from_its_track(tmp_path, command):
    """Twelve seconds are enough for the friction."""
    factors, delay_s = (1.05, 0.96), 1e-3 * CAMERA.delay_ms
    truth = np.array([0.22, 0.014, 5e-4, -6e-4, *factors, delay_s])
    write_track(tmp_path / "track.csv", observed(truth, excitation(CoSimConfig())[1:5]))
    out = tmp_path / "robot"
    given = ("--motor-parameter", "J=3e-9")
    done = command("identify-robot", tmp_path / "track.csv", "--out", out, "--json", *given)
    said = json.loads(done.stdout.splitlines()[-1])
    found = {parameter["name"]: parameter for parameter in said["parameters"]}
    assert tuple(found) == NAMES
    mu = found["mu"]
    assert mu["low"] < truth[0] < mu["high"]
    assert mu["identifiable"]
    assert len(mu["rises"]) == 2
    preset = find_preset(out / "preset.toml")
    assert preset.config().robot.mu == mu["value"]
    assert preset.config().motor.J == 3e-9
    assert preset.tree["J"][1].endswith("; J given by motor_parameters")
    assert preset.config().world.camera.rate_hz == 30.0
    assert "| com_x_m | centre of mass before the axis | " in (out / "report.md").read_text()
    assert "<svg" in (out / "tracks.svg").read_text()
    assert json.loads((out / "identification.json").read_text()) == said


@pytest.mark.long
@pytest.mark.parametrize("name", ["kilobot", pytest.param("drawn", marks=pytest.mark.slow)])
def test_a_machine_of_its_own_is_identified_from_its_track(tmp_path, command, name):
    """Two vertical shafts on three feet, and four drawn motors on four feet; two motors run."""
    file = tmp_path / "drawn.toml"
    file.write_text(drawn(1))
    given = file if name == "drawn" else name
    config = find_preset(given).config()
    parameters, motors = parameters_of(config.robot), len(config.robot.motors)
    truth = usual_values(config.robot)
    truth += [0.4 * sign * p.spread for sign, p in zip((1, -1) * 8, parameters, strict=False)]
    truth[-1] = 1e-3 * CAMERA.delay_ms
    write_track(tmp_path / "track.csv", observed(truth, excitation(config)[:10], config))
    out = tmp_path / "robot"
    options = ("--preset", given, "--out", out, "--json")
    done = command("identify-robot", tmp_path / "track.csv", *options)
    said = json.loads(done.stdout.splitlines()[-1])
    found = {parameter["name"]: parameter for parameter in said["parameters"]}
    assert tuple(found) == tuple(p.name for p in parameters)
    known = dict(zip(found, truth, strict=True))
    driven = ("motor_d", "motor_g" if name == "drawn" else "motor_e")
    for each in ("mu", *driven):
        assert found[each]["identifiable"]
        assert found[each]["low"] < known[each] < found[each]["high"]
    robot = find_preset(out / "preset.toml").config().robot
    assert robot.mu == found["mu"]["value"]
    assert len(robot.motors) == motors

"""Every curve of every kind of figure is the quantity that its axis names.

The data is made up, with other values for each quantity, so that a figure that draws another one
is noticed. Motors are drawn in `tests/analysis/test_motor_loop.py`, studies in
`tests/agent/study/test_plot.py`.
"""

from types import SimpleNamespace
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.container import ErrorbarContainer
from matplotlib.patches import Circle, Rectangle

from agent.evaluation.statistics import summarise
from agent.training.loop import TrainingLog
from analysis.figures import fig03, fig05, learning, machine, motor_cycle, paths, transfer, values
from analysis.figures.motor_cycle import Cycle
from analysis.figures.paths import Track
from analysis.reading.results import DRIVEN_BY
from cosim.base.colours import robot_colour
from cosim.calibration.primitives import Primitive
from cosim.machine.platform.motion import Motion, PlatformResult
from cosim.model.params import TABLE_I, Foot, Mount
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import BUILT_IN, find_scenario
from cosim.recording.series import PolicyMap

POINTS = 7
SHARES = {"success", "greedy_success"}


def made_up(seed: int, shape: tuple[int, ...] = (POINTS,), low=0.0, high=1.0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(low, high, shape)


def variant(label: str, scenario: str, runs: int, seed: int) -> learning.VariantCurves:
    def log(run: int) -> Any:
        curves = {
            name: made_up(seed + 100 * run + k, high=1.0 if name in SHARES else 1000.0)
            for k, name in enumerate(TrainingLog._fields)
        }
        episodes = 1e5 * np.arange(1, POINTS + 1)
        return SimpleNamespace(**curves | {"episode": episodes, "greedy_episode": 2 * episodes})

    return learning.VariantCurves(label, scenario, tuple(log(run) for run in range(runs)))


def assert_curves(axes: Any, variants, prefix: str, name: str) -> None:
    """Means are the lines with labels; few runs have a line each, more a band within limits."""
    means = [line for line in axes.lines if not line.get_label().startswith("_")]
    bands: list[Any] = [each for each in axes.collections if isinstance(each, PolyCollection)]
    factor, most = (100.0, 100.0) if prefix + name in SHARES else (1.0, np.inf)
    for number, (line, each) in enumerate(zip(means, variants, strict=True)):
        curves = factor * np.stack([getattr(log, prefix + name) for log in each.logs])
        episodes = getattr(each.logs[0], f"{prefix}episode") / 1e6
        drawn = np.column_stack([episodes, curves.mean(axis=0)])
        np.testing.assert_allclose(line.get_xydata(), drawn)
        if len(curves) < learning.LEAST_RUNS:
            assert not bands
            runs = [one for one in axes.lines if one.get_color() == line.get_color()][1:]
            np.testing.assert_allclose([one.get_ydata() for one in runs], curves)
        else:
            heights = bands[number].get_paths()[0].vertices[:, 1]
            assert 0.0 <= heights.min() < heights.max() <= most
            assert heights.max() > curves.mean(axis=0).max() or heights.max() == most


@pytest.mark.parametrize("runs", [2, 6])
def test_learning_curves(runs):
    variants = {name: variant(f"c = {name}", "4", runs, 7 * k) for k, name in enumerate("ab")}
    figure: Any = learning.draw_learning_curves(variants, "b")
    *learnt, differences = figure.axes
    line, same = (line for line in differences.lines if line.get_label()[0] == "c")
    a, b = (each.curves("greedy_path_length_cm") for each in variants.values())
    np.testing.assert_allclose(line.get_ydata(), (a - b).mean(axis=0))
    np.testing.assert_array_equal(same.get_ydata(), 0.0)
    assert differences.get_ylabel() == "cm more than c = b"
    panels = [
        (prefix, name) for prefix in ("", "greedy_") for name in ("success", "path_length_cm")
    ]
    for axes, (prefix, name) in zip(learnt, panels, strict=True):
        assert_curves(axes, variants.values(), prefix, name)
        assert ("%" in axes.get_ylabel()) == (name == "success")
        assert axes.get_ylim()[0] > -60.0
    assert figure.axes[0].get_ylim() == (-3.0, 103.0)


@pytest.mark.parametrize("runs", [2, 6])
def test_learning_curves_by_scenario(runs):
    variants = {f"{s}-{k}": variant(f"{s}, {k}", s, runs, 7 * k) for s in "46" for k in (0, 1)}
    axes: Any = np.reshape(np.array(learning.draw_by_scenario(variants).axes, dtype=object), (2, 2))
    for column, scenario in enumerate("46"):
        own = [each for each in variants.values() if each.scenario == scenario]
        assert axes[0, column].get_title(loc="left") == f"scenario {scenario}"
        assert_curves(axes[0, column], own, "greedy_", "success")
        assert_curves(axes[1, column], own, "greedy_", "path_length_cm")
    assert axes[0, 0].get_ylim() == (-3.0, 103.0)


def test_bands_end_at_what_is_possible_and_leave_out_points_without_a_run():
    axes: Any = plt.figure().add_subplot()
    rates = np.array([[100.0, 0.0]] * 3 + [[10.0, 90.0], [20.0, 80.0], [30.0, 70.0]])
    learning.plot_band(axes, np.array([1e6, 2e6]), rates, "x", (0.0, 100.0))
    assert {0.0, 100.0} <= set(axes.collections[0].get_paths()[0].vertices[:, 1])
    assert axes.dataLim.intervaly.tolist() == [0.0, 100.0]
    axes = plt.figure().add_subplot()
    curves = np.array([[1.0, np.nan, 3.0], [3.0, np.nan, np.nan]])
    learning.plot_band(axes, np.array([0.0, 1e6, 2e6]), curves, "x")
    assert axes.lines[0].get_xydata().tolist() == [[0.0, 2.0], [2.0, 3.0]]


def test_thinning_takes_means_without_missing_points():
    curves = np.arange(2.0 * 10 * learning.POINTS).reshape(2, -1)
    curves[0, 3] = np.nan
    episodes, thin = learning.thinned(np.arange(10.0 * learning.POINTS), curves)
    assert thin.shape == (2, learning.POINTS)
    assert thin[0, 0] == pytest.approx(np.mean([0, 1, 2, 4, 5, 6, 7, 8, 9]))
    assert episodes[0] == 4.5
    short = np.ones((2, 5))
    assert np.array_equal(learning.thinned(np.arange(5.0), short)[1], short)


@pytest.mark.parametrize(
    ("rates", "after"),
    [([0.2, 1.0, 0.9, 1.0, 1.0], 4000), ([1.0, 1.0], 1000), ([1.0, 0.5], None)],
)
def test_learnt_is_where_success_stays_high(rates, after):
    episodes = 1000 * np.arange(1, 1 + len(rates))
    log: Any = SimpleNamespace(greedy_success=np.array(rates), greedy_episode=episodes)
    assert learning.settled_after(learning.VariantCurves("x", "2", (log,)), 0.99) == after


@pytest.mark.parametrize("runs", [3, 8])
def test_ratios_to_the_optimum(runs):
    names = "ratio_to_bound", "steps_ratio_to_bound"

    def one(seed: int) -> Any:
        values = {n: made_up(seed + k, (runs,), 1.0, 2.0) for k, n in enumerate(names)}
        each = [SimpleNamespace(**{n: v[k] for n, v in values.items()}) for k in range(runs)]
        over = {name: summarise(v, 0.0) for name, v in values.items()}
        return SimpleNamespace(scenario=f"s{seed}", runs=each, over_runs=over)

    variants = {str(seed): one(seed) for seed in (0, 10)}
    figure: Any = learning.draw_ratios(variants)
    for axes, name in zip(figure.axes, names, strict=True):
        means = [each for each in axes.containers if isinstance(each, ErrorbarContainer)]
        assert len(means) == (2 if runs >= learning.LEAST_RUNS else 0)
        dots = [line for line in axes.lines if line.get_marker() == "."]
        for line, each in zip(dots, variants.values(), strict=True):
            np.testing.assert_array_equal(line.get_ydata(), [getattr(r, name) for r in each.runs])
        for container, each in zip(means, variants.values(), strict=False):
            (segment,) = container.lines[2][0].get_segments()
            over = each.over_runs[name]
            np.testing.assert_allclose(segment[:, 1], [over.low, over.high])
            assert container.lines[0].get_ydata() == pytest.approx([over.mean])


def test_success_by_method(row):
    def heights(axes: Any) -> dict[str, Any]:
        bars: list[Any] = [each for each in axes.containers if isinstance(each, ErrorbarContainer)]
        return {bar.get_label(): bar.lines[0].get_ydata().tolist() for bar in bars}

    paper = row("1a", "paper", 0.8), row("2", "paper", 0.6)
    moves = row("1a", "moves", 1.0), row("2", "moves", 0.9), row("2", "moves", 1.0, shield=True)
    low_friction, default = transfer.draw([*paper, *moves, row("2", "moves", 0.5, mu=0.1)]).axes
    assert low_friction.get_title(loc="left") == "µ = 0.1"
    assert default.get_title(loc="left") == "µ = 0.15"
    assert heights(low_friction) == {"paper": [], "moves": [50.0], "moves, shield": []}
    expected = {"paper": [80.0, 60.0], "moves": [100.0, 90.0], "moves, shield": [100.0]}
    assert heights(default) == expected


@pytest.mark.parametrize("name", BUILT_IN)
def test_boards(name):
    axes: Any = plt.figure().add_subplot()
    scenario = find_scenario(name)
    fig05.draw_board(axes, scenario)
    cells = 1 + sum(len(starts) + 1 for starts in scenario.starts)
    assert len(axes.patches) == cells + len(scenario.obstacles)
    squares = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
    dark = {square.get_xy() for square in squares if square.get_alpha() == 0.8}
    assert dark == set(scenario.obstacles)


def test_boards_are_drawn_whole():
    axes: Any = plt.figure().add_subplot()
    fig05.draw_board(axes, Scenario("flat", "", ((5, 5),), (((9, 9),),), 40, 20, cell_m=0.02))
    assert (axes.get_xlim(), axes.get_ylim()) == ((0.0, 80.0), (0.0, 40.0))


def track(seed: int, robots: int, outcome: str) -> Track:
    times = np.arange(0.0, 30.0, 1.0)
    positions = tuple(made_up(seed + k, (len(times), 2), high=0.3) for k in range(robots))
    return Track(times, positions, outcome, (0.1,) * robots, 30.0)


def test_paths_of_one_robot():
    axes: Any = plt.figure().add_subplot()
    tracks = [track(0, 1, "success"), track(5, 1, "collision")]
    paths.draw_tracks(axes, find_scenario("1a"), tracks)
    lines = zip(axes.lines[::2], axes.lines[1::2], tracks, "-:", strict=True)
    for line, marks, each, style in lines:
        (position,) = each.positions_m
        np.testing.assert_array_equal(line.get_xydata(), 100.0 * position)
        assert (line.get_linestyle(), line.get_color()) == (style, robot_colour(0))
        np.testing.assert_array_equal(marks.get_xydata(), 100.0 * position[[10, 20]])
    rims = iter(patch for patch in axes.patches if isinstance(patch, Circle))
    assert [(rim.center, rim.get_alpha()) for rim in rims] == [
        (tuple(100.0 * each.positions_m[0][at]), alpha)
        for each in tracks
        for at, alpha in ((0, 0.35), (-1, 0.8))  # fainter at the start, as the key says
    ]


def test_paths_and_distances_of_pairs():
    tracks = {
        (name, method): [track(10 * k + 100 * m + e, 2, "success") for e in (0, 5)]
        for m, method in enumerate(DRIVEN_BY)
        for k, name in enumerate(paths.PAIRS)
    }
    grid: Any = np.reshape(np.array(paths.draw_pairs(tracks).axes, dtype=object), (3, 3))
    for (name, method), found in tracks.items():
        boards = grid[:, paths.PAIRS.index(name)]
        lines = boards[DRIVEN_BY.index(method)].lines[::2]
        for robot, (line, position) in enumerate(zip(lines, found[0].positions_m, strict=True)):
            np.testing.assert_array_equal(line.get_xydata(), 100.0 * position)
            assert line.get_color() == robot_colour(robot)
        drawn = [line for line in boards[2].lines if line.get_linestyle() == paths.STYLES[method]]
        for line, each in zip(drawn, found, strict=False):
            x, y = (each.positions_m[0] - each.positions_m[1]).T
            over_time = np.column_stack([each.times_s, 100.0 * np.hypot(x, y)])
            np.testing.assert_allclose(line.get_xydata(), over_time)


def test_a_turn_of_the_motors():
    sizes = {"omega": (20, 2), "normal_n": (20, 3), "lifted": (20, 3), "slides": (20, 3)}
    arrays: dict[str, Any] = {
        name: made_up(k, sizes.get(name, (20,)), 0.1) for k, name in enumerate(Cycle._fields)
    }
    arrays["theta"] = np.column_stack([np.linspace(1.0, 7.5, 20), np.linspace(0.0, -6.5, 20)])
    arrays["lifted"] = arrays["lifted"] > 0.7
    cycle = Cycle(**arrays | {"robot": "r1", "apart_rad": 0.1, "impact_n_s": 0.2})
    share = np.mean([foot.any() for foot in cycle.lifted])  # of the turn with any foot in the air
    assert 0.0 < motor_cycle.drawing_of(cycle).numbers["lifted_share"] == share < 1.0
    figure: Any = motor_cycle.draw(cycle)
    expected = (
        {"driving force": cycle.driving_n, "friction": cycle.friction_n},
        {f"foot {name}": cycle.normal_n[:, k] for k, name in enumerate("ABC")},
        {f"motor {name}": cycle.omega[:, k] for k, name in enumerate("DE")},
        {"_child0": 1e6 * cycle.ahead_m},
    )
    for axes, curves in zip(figure.axes, expected, strict=True):
        drawn = {line.get_label(): line for line in axes.lines}
        assert drawn.keys() == curves.keys()
        for label, curve in curves.items():
            np.testing.assert_allclose(drawn[label].get_xdata(), np.rad2deg(cycle.theta[:, 0]))
            np.testing.assert_allclose(drawn[label].get_ydata(), curve)
    held = figure.axes[0].collections[0].get_paths()[0].vertices[:, 1]
    assert (held.max(), held.min()) == (cycle.holds_n.max(), -cycle.holds_n.max())


def test_motion_of_the_platform():
    turns = np.linspace(0.0, 6.0 * np.pi, 31)

    def motion(seed: int) -> Motion:
        arrays = [made_up(seed + k, (31,)) for k in range(4)]
        return Motion(turns, *arrays, *(np.array(value + seed) for value in (300.0, 0.5, 2e-3)))

    motions = motion(0), motion(20)
    figure: Any = fig03.draw(PlatformResult(*motions, None))  # pyright: ignore[reportArgumentType]
    for row, each in zip((figure.axes[:3], figure.axes[3:]), motions, strict=True):
        factor = 1e3 if each.net_displacement_m >= 1e-4 else 1e6
        position, force = factor * each.position_m, each.driving_force_n
        over_time = np.column_stack([1e3 * each.time_s, position])
        np.testing.assert_allclose(row[0].lines[0].get_xydata(), over_time)
        np.testing.assert_allclose(row[1].lines[0].get_ydata(), position[20:] - position[20])
        assert row[1].texts[1].get_text().startswith(f"{factor * each.net_displacement_m:.3g}")
        over_angle = np.column_stack([np.rad2deg(turns[:11]), force[:11]])
        np.testing.assert_allclose(row[2].lines[0].get_xydata(), over_angle)
        held = row[2].collections[0].get_paths()[0].vertices[:, 1]
        assert held.max() == each.friction_limit_n[:11].max()
        assert f"ω = {each.omega_rad_s:.0f} rad/s, µ = {each.mu:g}" in row[0].get_title(loc="left")


def test_machines_are_drawn_in_both_views():
    mounts = (
        Mount((0.004, 0.011, 0.006), (0.0, 0.8, 0.6)),
        Mount((-0.01, 0.002, 0.02), (1.0, 0.0, 0.0)),
    )
    feet = Foot(0.02, 0.001), Foot(-0.015, 0.012), Foot(-0.011, -0.017)
    robot = TABLE_I._replace(motors=mounts, feet=feet, com_x_m=0.002, com_y_m=-0.003)
    figure: Any = machine.draw_machines({"$own": robot})
    for axes, view in zip(figure.axes, (machine.ABOVE, machine.SIDE), strict=True):
        drawn = {label: [] for label in ("motor, at its mass", "foot", "shaft", "centre of mass")}
        for line in axes.lines:
            drawn.get(line.get_label(), []).append(np.array(line.get_xydata()))
        places = [[each.place_m[k] for k in view] for each in mounts]
        np.testing.assert_allclose(
            np.concatenate(drawn["motor, at its mass"]), 1e3 * np.array(places)
        )
        floor = [[(foot.x_m, foot.y_m, 0.0)[k] for k in view] for foot in feet]
        np.testing.assert_allclose(np.concatenate(drawn["foot"]), 1e3 * np.array(floor))
        (centre,) = drawn["centre of mass"]
        np.testing.assert_allclose(centre[0], [(2.0, -3.0, 15.0)[k] for k in view])
        for (start, tip), mount in zip(drawn["shaft"], mounts, strict=True):
            along = np.array([mount.axis[k] for k in view])
            np.testing.assert_allclose(tip - start, 0.3 * 25.0 * along, atol=1e-12)
        # Bodies of the motors lie behind their masses.
        bodies = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
        bodies = [body for body in bodies if body.get_facecolor() == to_rgba(machine._MOTOR)]
        for body, place, mount in zip(bodies, places, mounts, strict=True):
            middle = body.get_patch_transform().transform((0.5, 0.5))
            behind = 0.5 * 1e3 * robot.motor_length_m * np.array([mount.axis[k] for k in view])
            np.testing.assert_allclose(middle, 1e3 * np.array(place) - behind, atol=1e-9)
    assert figure.axes[0].get_title(loc="left") == "$own"


def test_primitives_are_drawn_where_the_front_goes():
    """A turn about the robot's axis by 9° a second, and one straight to the left."""
    still = {"spread": (0.0, 0.0, 0.0), "airborne_share": 0.0, "difference": (), "yaw_gain": 1.0}
    rate, angle = np.deg2rad(9.0), np.deg2rad(90.0)
    found = {
        "left_turn": Primitive(set_points_rad_s=(), mean=(0.0, 0.0, rate), **still),
        "leftwards": Primitive(set_points_rad_s=(), mean=(0.0, 0.002, 0.0), **still),
        "forwards": Primitive(set_points_rad_s=(), mean=(0.0, 0.0, rate), **still),  # it cannot
    }
    figure: Any = machine.draw_primitives(found, TABLE_I)
    ends = {each.get_label(): each.get_xydata()[-1] for each in figure.axes[0].lines}
    np.testing.assert_allclose(ends["left turn"], 25.0 * np.array([np.cos(angle), np.sin(angle)]))
    np.testing.assert_allclose(ends["leftwards"], [25.0, 20.0])
    assert "forwards" not in ends


def test_values_are_drawn_where_they_are_on_a_board_that_is_not_square():
    zone = (5, 0, 7, 2)
    scenario = Scenario("wide", "", ((6, 1),), (((0, 0),),), 8, 3, zone=zone)
    value, there = np.arange(24.0).reshape(8, 3), np.full((8, 3), 10)
    axes = values.draw(PolicyMap(value, 0 * there, there), scenario).axes[0]
    shown = np.asarray(axes.images[0].get_array())
    assert shown[1, 6] == value[6, 1]
    assert np.asarray(axes.lines[0].get_xydata()).tolist() == [[6, 1]]

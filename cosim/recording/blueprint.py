"""Layout that the Rerun viewer shows when a recording is opened: the arrangement of views.

Entity paths are listed one by one: wildcards inside a path match nothing, without a warning.
"""

from collections.abc import Sequence
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from cosim.model.params import TABLE_I, RobotParams
from cosim.recording.series import SignalSpec, in_eight, robot_names, signals_of

_ALWAYS = rrb.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())
_WHOLE_TIME = rrb.TimeAxis(view_range=_ALWAYS)
_UNTIL_CURSOR = rr.TimeRangeBoundary.cursor_relative(seconds=0.0)
_Q = "rl/q_s"
_TRAIL_S = 600.0  # shown of a trail, of which each row has a piece
# A burst is short: show what lies around the time cursor.
_AROUND_CURSOR = rrb.TimeAxis(
    view_range=rrb.TimeRange(
        start=rr.TimeRangeBoundary.cursor_relative(seconds=-0.002),
        end=rr.TimeRangeBoundary.cursor_relative(seconds=0.022),
    )
)


def episode_blueprint(
    robots: int | Sequence[int],
    size_m: tuple[float, float],
    *,
    bursts: bool = True,
    policies: bool = False,
    distances: bool = True,
    camera: bool = False,
    machine: RobotParams = TABLE_I,
) -> rrb.Blueprint:
    """Arena above timelines of actions on the left, tabs of plots on the right.

    Args:
        robots: number of robots, or indices of those with signals to show.
        policies: whether the robots' policies are drawn on the floor; then the first tab has action
            values and rewards, else where robots are.
        machine: plots are named after its motors.
    """
    names = robot_names(robots)
    signals = signals_of(machine, distances=len(names) > 1 and distances, camera=camera)

    def plots(title: str, *tabs: str, time: rrb.TimeAxis = _WHOLE_TIME) -> rrb.Grid:
        views: list[tuple[str, list[SignalSpec]]] = []
        for signal in signals:
            if not set(signal.tabs) & {title, *tabs}:
                continue
            if signal.label:
                views.append((signal.label, [signal]))
            else:
                views[-1][1].append(signal)
        learning = title == "learning"
        legend = " (legend: tab learning)"
        grid = [
            rrb.TimeSeriesView(
                origin="/",
                contents=[signal.entity(name) for signal in drawn],
                name=f"{label}{legend * (drawn[0].path == _Q and not learning)} · {name}",
                axis_x=time,
                # A robot's colour tells its signals, the label their order; a legend hides curves,
                # and is shown where colours are others, of the eight directions where they have
                # room for it, below their rise.
                plot_legend=rrb.PlotLegend(
                    corner=rrb.Corner2D.RightBottom,
                    visible=in_eight(drawn[0].names) and (learning or drawn[0].path != _Q),
                ),
            )
            for label, drawn in views
            for name in names
        ]
        shares = [2] + [1] * (len(views) - 1) if learning else None
        name = "plots" if learning else title
        return rrb.Grid(*grid, grid_columns=len(names), row_shares=shares, name=name)

    def states(title: str, *paths: str, also: tuple[str, ...] = ()) -> rrb.StateTimelineView:
        return rrb.StateTimelineView(
            origin="/",
            contents=[*(f"/rl/{name}/{path}" for name in names for path in paths), *also],
            name=title,
            time_view=_WHOLE_TIME,
        )

    tabs = [
        plots("overview", "values" if policies else "places"),
        *(plots(title) for title in ("motors", "motion", *camera * ["camera"], "contact")),
        rrb.Vertical(
            plots("learning"),
            states(
                "greedy direction, distance and its change", "greedy", "distance_class", "gradient"
            ),
            row_shares=[4, 1],
            name="learning",
        ),
        rrb.Horizontal(
            rrb.TextLogView(origin="/log", name="log"),
            rrb.TextDocumentView(origin="/info/run", name="run"),
            name="information",
        ),
    ]
    if bursts:
        tabs.insert(3, plots("bursts at every tick", time=_AROUND_CURSOR))
    if policies:
        floors = [_arena(f"policy · {name}", size_m, names, name) for name in names]
        tabs.insert(-1, rrb.Tabs(*floors, name="policies"))  # arrows need the room
    arena = _arena("arena", size_m, names)
    return plain_blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                arena,
                states(
                    "actions, what the steering does, and how moves end",
                    *("action", "steering", "move", "failure"),
                    also=("/outcome",),
                ),
                row_shares=[3, 2],
            ),
            rrb.Tabs(*tabs, active_tab=0),
            column_shares=[2, 3],
        ),
        rrb.TimePanel(timeline="sim_time", state="collapsed"),
    )


def plain_blueprint(layout: Any, time: rrb.TimePanel) -> rrb.Blueprint:
    """Return a layout as it is, without the viewer's other panels and views of its own."""
    hidden = rrb.BlueprintPanel(state="hidden"), rrb.SelectionPanel(state="hidden")
    return rrb.Blueprint(layout, time, *hidden, auto_layout=False, auto_views=False)


def _arena(
    title: str, size_m: tuple[float, float], names: list[str], policy_of: str | None = None
) -> rrb.Spatial3DView:
    """The board from the south with robots; or from above with the policy of one of them."""
    width, height = size_m
    hidden = [f"- /world/{name}/policy/**" for name in names if name != policy_of]
    eye, up = (0.5 * width, -0.4 * height, 0.95 * height), (0.0, 0.0, 1.0)
    if policy_of is not None:
        hidden += [f"- /world/{name}/{part}/**" for name in names for part in ("robot", "plan")]
        eye, up = (0.5 * width, 0.5 * height, 1.6 * max(size_m)), (0.0, 1.0, 0.0)
    shown: dict[Any, Any] = {
        f"/world/{name}/{path}": rrb.VisibleTimeRanges(
            timeline="sim_time", start=start, end=_UNTIL_CURSOR
        )
        for path, start in (
            ("trail", rr.TimeRangeBoundary.cursor_relative(seconds=-_TRAIL_S)),
            ("visited", rr.TimeRangeBoundary.infinite()),
        )
        for name in names
    }
    return rrb.Spatial3DView(
        origin="/world",
        contents=["+ /world/**", *hidden],
        name=title,
        overrides=shown,
        eye_controls=rrb.EyeControls3D(
            position=eye,
            eye_up=up,
            look_target=(0.5 * width, (0.5 if policy_of else 0.42) * height, 0.0),
        ),
        line_grid=rrb.LineGrid3D(visible=False),
    )


def training_blueprint(robots: int, columns: int = 0, rows: int = 0) -> rrb.Blueprint:
    """Learning curves on the left, value maps and visits on the right; only curves of no robot."""
    names = robot_names(robots)
    # Room for the labels of the colour bars, which the viewer leaves out when it fits a view.
    bounds = rrb.VisualBounds2D(x_range=[-1, columns + 6], y_range=[-2, rows + 2])
    below, above = rrb.Corner2D.RightBottom, rrb.Corner2D.RightTop
    curves = [
        rrb.TimeSeriesView(
            origin="/",
            contents=[f"/train/{path}/**" for path in paths],
            name=title,
            axis_x=_WHOLE_TIME,
            plot_legend=rrb.PlotLegend(corner=corner),  # where no curve is
        )
        for title, corner, *paths in (
            ("success rate", below, "success", "greedy/success"),
            ("path length cm", above, "path_length", "greedy/path_length"),
            ("return", below, "return"),
            ("exploration ε", above, "epsilon"),
        )
    ]
    maps = [
        rrb.Spatial2DView(
            origin=f"/q/{name}/{path}", name=f"{title} · {name}", visual_bounds=bounds
        )
        for path, title in (("value_map", "value"), ("policy", "policy"), ("visits", "visits"))
        for name in names
    ]
    everything = rrb.Grid(*curves, grid_columns=2)
    if maps:
        tables = rrb.Grid(*maps, grid_columns=robots)
        everything = rrb.Horizontal(rrb.Vertical(*curves), tables, column_shares=[2, 3])
    # The latest maps are there at once, earlier ones by moving the cursor.
    time = rrb.TimePanel(timeline="episode", state="collapsed", play_state="Following")
    return plain_blueprint(everything, time)

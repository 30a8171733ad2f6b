"""An episode as a video: the board from above with robots, trails, targets and a clock."""

from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.text import Text

from analysis.figures.fig05 import draw_board
from cosim.base.colours import robot_colour
from cosim.base.errors import FileError, UserError, installing
from cosim.base.plotting import styled
from cosim.base.progress import Progress, silent
from cosim.base.storage import replacing
from cosim.recording.reader import Episode

FRAMES_PER_S = 12
_TRAIL_S = 30.0  # simulated time of a trail
_BESIDE = 1.7  # cells from the left edge of a target to the middle of its number


@styled
def write_video(
    episode: Episode, out: Path, speed: float = 10.0, progress: Progress = silent
) -> int:
    """Write the board from above over time and return the number of frames.

    Args:
        out: video (.mp4, with the extra `video`) or animated picture (.gif).
        speed: simulated seconds per second of the video.
    """
    if (scenario := episode.scenario) is None:
        raise FileError(f"{episode.origin} does not say what its board is; record it again")
    writer = _writer(out)
    figure, axes = plt.subplots(figsize=(4.8, 5.1))
    draw_board(axes, scenario)
    width, height = (100.0 * size for size in scenario.size_m)
    rim = 50.0 * scenario.diameter_m  # of robots whose centres are at the board's edge
    axes.add_patch(Rectangle((0.0, 0.0), width, height, fill=False))
    axes.spines[:].set_visible(False)
    axes.set(xlabel="", xticks=[], yticks=[], xlim=(-rim, width + rim), ylim=(-rim, height + rim))
    drawn = [_robot(axes, episode, number) for number in range(len(episode.robots))]
    for number, (x, y) in enumerate(scenario.targets):
        beside = 100.0 * scenario.cell_m * (x + _BESIDE), 100.0 * scenario.cell_m * (y + 0.5)
        _number(axes, number, scenario.robots).set_position(beside)
    times_s = [*np.arange(0.0, episode.time_s, speed / FRAMES_PER_S).tolist(), episode.time_s]
    with replacing(out) as temporary, writer.saving(figure, str(temporary), dpi=100):
        for time_s in times_s:
            for move in drawn:
                move(time_s)
            over = time_s == episode.time_s and episode.outcome
            state = episode.outcome if over else f"{speed:g} x"
            axes.set_title(f"{time_s:5.1f} s   {state}", loc="left")
            writer.grab_frame()
            progress("drawing", time_s, episode.time_s)
    plt.close(figure)
    return len(times_s)


def _writer(out: Path) -> FFMpegWriter | PillowWriter:
    if out.suffix == ".gif":
        return PillowWriter(fps=FRAMES_PER_S)
    if out.suffix != ".mp4":
        raise UserError(f"{out}: name a file that ends in .mp4 or .gif")
    try:
        import imageio_ffmpeg  # noqa: PLC0415 - optional
    except ImportError as error:
        fix = f"run `{installing('video')}`, or name a file that ends in .gif"
        raise UserError(f"{out}: imageio-ffmpeg is not installed; {fix}") from error
    mpl.rcParams["animation.ffmpeg_path"] = imageio_ffmpeg.get_ffmpeg_exe()
    return FFMpegWriter(fps=FRAMES_PER_S, extra_args=["-pix_fmt", "yuv420p", "-f", "mp4"])


def _number(axes: Axes, robot: int, robots: int) -> Text:
    """Write the number of one of several robots on the board, as colours are used in turn."""
    style = {"ha": "center", "va": "center", "fontsize": 7, "clip_on": True, "zorder": 3}
    edge = [withStroke(linewidth=2.0, foreground="white")]
    return axes.text(0.0, 0.0, str(robot + 1) if robots > 1 else "", style, path_effects=edge)


def _robot(axes: Axes, episode: Episode, number: int) -> Callable[[float], None]:
    """Draw a robot on the board; the function moves it to where it is at a time."""
    robot, colour = episode.robots[number], robot_colour(number)
    position, heading = (episode.signals[f"{robot}/{name}"] for name in ("position", "heading"))
    radius = 50.0 * episode.parameter("diameter_m")
    disc = Circle((0.0, 0.0), radius, facecolor=colour, alpha=0.5)
    axes.add_patch(disc)
    number_text = _number(axes, number, len(episode.robots))
    nose, trail = (axes.add_line(Line2D([], [], color=c)) for c in ("black", colour))

    def move(time_s: float) -> None:
        first, now = np.searchsorted(position.time_s, (time_s - _TRAIL_S, time_s), "right")
        path = 100.0 * position.values[max(0, first - 1) : max(1, now), :2]
        at = path[-1]
        angle = np.interp(time_s, heading.time_s, np.unwrap(heading.values))
        disc.set(center=at)
        number_text.set_position(at)
        ahead = at + radius * np.array((np.cos(angle), np.sin(angle)))
        nose.set_data([at[0], ahead[0]], [at[1], ahead[1]])
        trail.set_data(*path.T)

    return move

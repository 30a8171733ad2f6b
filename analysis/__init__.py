"""Looking back: reads recordings and result files and draws the paper's figures."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cosim.recording.reader import Episode


def open(path: "Path | str") -> "Episode":  # noqa: A001 - to be called as analysis.open
    """Read the recording of an episode.

    >>> import minirobots as mr
    >>> policy = mr.train("1a", method="shortest", progress=None)
    >>> mr.simulate("1a", policy, time_limit=4.0, progress=None).save("episode.rrd")
    >>> mr.open("episode.rrd").outcome
    'timeout'

    Args:
        path: an .rrd file, or the .rrd.part that a killed run left.

    Returns:
        The episode: its outcome, robots, parameters, moves, and `signals`, which by names such as
        "r1/motors/omega" have `values` (n,) or (n, k), `time_s` (n,) in s, `unit` and
        `components`.

    Raises:
        FileError: the file does not exist, cannot be read, or holds no episode.
    """
    from cosim.base.arguments import validate_argument  # noqa: PLC0415
    from cosim.recording.reader import read_episode  # noqa: PLC0415 - rerun is slow to import

    return read_episode(validate_argument("path", path, Path))

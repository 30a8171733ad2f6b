"""Names, colours and order of the plotted signals of an episode."""

import rerun as rr

from cosim.blueprint import robot_names
from cosim.features import DIRECTION_COUNT, GRADIENT_SIGNS
from cosim.recording import Recording
from cosim.scene import EIGHT, LIGHT, SERIES, palette

DIRECTION_NAMES = tuple(f"{360 * k // DIRECTION_COUNT}°" for k in range(DIRECTION_COUNT))
ARRIVED = "at target"

# Signals of vector entities: path below /sim/<robot>, names of the components.
SIM_SERIES = {
    "motors/omega": ("D", "E"),
    "motors/omega_des": ("D", "E"),
    "motors/voltage": ("D", "E"),
    "motors/current": ("D", "E"),
    "motors/theta": ("D", "E"),
    "position": ("x", "y"),
    "heading": ("heading",),
    "velocity": ("x", "y"),
    "heading_error": ("heading error",),
    "contact/normal_max": ("A", "B", "C"),
    "contact/friction_max": ("A", "B", "C"),
    "contact/lifted_share": ("share",),
    "contact/touching_share": ("share",),
}
RAW_SERIES = {
    "omega": ("D", "E"),
    "position": ("x", "y", "z"),
    "normal": ("A", "B", "C"),
    "friction": ("A x", "A y", "B x", "B y", "C x", "C y"),
}


def write_styles(file: Recording, robots: int) -> None:
    """Log names, colours and aggregation of every signal of an episode."""
    for name in robot_names(robots):
        series = {f"/sim/{name}/{path}": names for path, names in SIM_SERIES.items()}
        series |= {f"/raw/{name}/{path}": names for path, names in RAW_SERIES.items()}
        series |= {f"/rl/{name}/{path}": (path,) for path in ("reward", "return", "distance")}
        series[f"/rl/{name}/cell"] = ("x", "y")
        series[f"/rl/{name}/q_s"] = DIRECTION_NAMES
        for entity, names in series.items():
            colours = SERIES if len(names) <= len(SERIES) else EIGHT
            file.static(
                entity,
                # The default, averaging, would flatten a vibration to nothing.
                rr.SeriesLines(
                    names=names,
                    colors=palette(colours[: len(names)]),
                    aggregation_policy="MinMax",
                ),
            )
        file.static(
            f"/rl/{name}/action",
            rr.StateConfiguration(
                values=[*DIRECTION_NAMES, ARRIVED],
                labels=[*DIRECTION_NAMES, ARRIVED],
                colors=palette([*EIGHT, LIGHT]),
            ),
        )
        file.static(
            f"/rl/{name}/gradient",
            rr.StateConfiguration(
                values=list(GRADIENT_SIGNS),
                labels=list(GRADIENT_SIGNS),
                colors=palette(SERIES),
            ),
        )

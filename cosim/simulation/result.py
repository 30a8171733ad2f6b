"""One episode in the results: its outcome and measurements."""

import math

import msgspec
import numpy as np

from cosim.model.outcome import Outcome
from cosim.model.scenario import Cell
from cosim.simulation.episode import RunningEpisode

# What a recording keeps of a result.
_FACTS = ("outcome", "path_length_cm", "rotation_deg", "sim_time_s", "contact_time_s")
_FACTS += ("energy_j", "conflicts", "min_distance_cm")
_DIGITS = 6  # of lengths in cm and energies in J; times have ticks of 1e-5 s


class EpisodeResult(msgspec.Struct, frozen=True):
    """One episode as `summary.json` and the results of an evaluation list it."""

    outcome: Outcome
    path_length_cm: float
    sim_time_s: float
    realtime_factor: float  # simulated time over wall-clock time, recording included
    recording: str | None  # its path relative to the output folder, None if there is none
    starts: tuple[Cell, ...]
    path_length_cm_by_robot: tuple[float, ...]
    # Time in which any robot touched another one or an obstacle; 0 of a collision that is a robot
    # in another one's target cell
    contact_time_s: float
    # Smallest distance between the centres of two robots, None for one alone
    min_distance_cm: float | None
    energy_j: float  # drawn by the motors of all robots, see `cosim.simulation.measures`
    energy_j_by_robot: tuple[float, ...]
    # Decisions that the shield changed, since plans would have come too close
    # (`cosim.onboard.yielding`)
    conflicts: int
    # What the episode has drawn from its world, None if that draws nothing
    drawn: dict[str, dict[str, float]] | None = None
    shield_stops: int | None = None  # moves that the shield has ended, None without it
    # How far each robot has turned, either way; results of before it was measured have none
    rotation_deg_by_robot: tuple[float, ...] = ()

    @property
    def rotation_deg(self) -> float:
        """Rotation as a mean over the robots."""
        return float(np.mean(self.rotation_deg_by_robot or (np.nan,)))

    @property
    def wall_s(self) -> float:
        """Wall-clock time that the episode took."""
        return self.sim_time_s / self.realtime_factor


def result_of(episode: RunningEpisode, starts: tuple[Cell, ...], wall_s: float) -> EpisodeResult:
    """Return an episode's result; `wall_s` is its share where others shared the work."""
    measures = episode.measures
    lengths = tuple(round(100.0 * float(v), _DIGITS) for v in measures.path_length_m)
    energies = tuple(round(float(v), _DIGITS) for v in measures.energy_j)
    alone = episode.scenario.robots == 1
    return EpisodeResult(
        outcome=episode.outcome,
        path_length_cm=float(np.mean(lengths)),
        sim_time_s=round(episode.time_s, 9),
        realtime_factor=episode.time_s / wall_s,
        recording=None,
        starts=starts,
        path_length_cm_by_robot=lengths,
        contact_time_s=round(measures.contact_time_s, 9),
        min_distance_cm=None if alone else round(100.0 * measures.min_distance_m, _DIGITS),
        energy_j=round(sum(energies), _DIGITS),
        energy_j_by_robot=energies,
        conflicts=episode.conflicts,
        drawn=episode.drawn.table() if episode.config.world.draws else None,
        shield_stops=episode.shield_stops if episode.config.shield else None,
        rotation_deg_by_robot=tuple(
            round(math.degrees(turned), _DIGITS) for turned in measures.rotation_rad
        ),
    )


def facts_of(result: EpisodeResult) -> dict[str, float | int | str]:
    """Return the facts of a result for a recording; the same whenever it is simulated."""
    facts = {name: getattr(result, name) for name in _FACTS} | {"outcome": str(result.outcome)}
    return {name: value for name, value in facts.items() if value is not None}

"""One episode of a policy in the co-simulation: its result, and its recording if wanted.

Which episodes, and in how many threads, is the business of `agent.evaluation.batch` (from start
cells drawn) and `agent.evaluation.cases` (from start cells enumerated).
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from agent.process.rewards import reward_parts
from agent.training.policy import Policy
from cosim.base.outcome import Outcome
from cosim.base.scenario import Cell
from cosim.navigation.episode import CoSimulation, Step, run_episode
from cosim.recording.episode import EpisodeRecorder

_DIGITS = 6  # of lengths in cm and energies in J; times have ticks of 1e-5 s


@dataclass(frozen=True)
class EpisodeResult:
    """One episode as `summary.json` and the results of an evaluation list it.

    Attributes:
        outcome: success, collision, out_of_board or timeout.
        path_length_cm: mean over the robots.
        sim_time_s: simulated time.
        realtime_factor: simulated time over wall-clock time, recording included.
        recording: its path relative to the output folder, None if there is none.
        starts: start cell of each robot.
        path_length_cm_by_robot: of each robot.
        contact_time_s: time in which any two robots touched.
        min_distance_cm: smallest distance between the centres of two robots, None for one alone.
        energy_j: drawn by the motors of all robots, see `cosim.navigation.measures`.
        energy_j_by_robot: of each robot.
        conflicts: decisions that the safety layer changed, or would have changed if it were on
            (`cosim.navigation.safety`). An episode without conflicts is, bit for bit, the same with
            the layer off and on at its default margin.
    """

    outcome: Outcome
    path_length_cm: float
    sim_time_s: float
    realtime_factor: float
    recording: str | None
    starts: tuple[Cell, ...]
    path_length_cm_by_robot: tuple[float, ...]
    contact_time_s: float
    min_distance_cm: float | None
    energy_j: float
    energy_j_by_robot: tuple[float, ...]
    conflicts: int

    @property
    def wall_s(self) -> float:
        """Wall-clock time that the episode took."""
        return self.sim_time_s / self.realtime_factor


def roll_out(
    system: CoSimulation,
    policy: Policy,
    starts: tuple[Cell, ...],
    noise_seed: np.random.SeedSequence,
    recorder: EpisodeRecorder | None = None,
    watch: Callable[[Step], None] = lambda _: None,
) -> EpisodeResult:
    """Run one episode and measure it.

    Args:
        system: may have run other episodes before.
        policy: acts, and names the process whose rewards are recorded.
        starts: start cell of each robot.
        noise_seed: of the speed noise.
        recorder: gets every RL step.
        watch: sees every RL step; may raise to end the episode.

    Raises:
        UserError: of an FMU or of the recording.
    """
    began = time.perf_counter()

    def observe(step: Step) -> None:
        watch(step)
        if recorder is not None:
            parts = reward_parts(policy.process, step, system.arrived)
            recorder.write(step, policy.q_values(step.before), parts)

    try:
        run_episode(system, policy, starts, noise_seed, observe)
    finally:
        system.close()
    wall_s = time.perf_counter() - began
    measures = system.measures
    lengths = tuple(round(100.0 * float(v), _DIGITS) for v in measures.path_length_m)
    energies = tuple(round(float(v), _DIGITS) for v in measures.energy_j)
    alone = system.scenario.robots == 1
    return EpisodeResult(
        outcome=system.outcome,
        path_length_cm=float(np.mean(lengths)),
        sim_time_s=round(system.time_s, 9),
        realtime_factor=system.time_s / wall_s,
        recording=None,
        starts=starts,
        path_length_cm_by_robot=lengths,
        contact_time_s=round(measures.contact_time_s, 9),
        min_distance_cm=None if alone else round(100.0 * measures.min_distance_m, _DIGITS),
        energy_j=round(sum(energies), _DIGITS),
        energy_j_by_robot=energies,
        conflicts=system.conflicts,
    )

"""Episodes of a policy in the co-simulation: as a record to look at, and as measured results.

`simulate` is for programs and notebooks; commands run many episodes through `simulate_episode`.
A policy is anything with `act(observation)`. What else it has is recorded: `q_values(observation)`
(N, 8), `reward_parts(step, arrived)` (N, 3) and `maps()`, see `agent.training.policy`.
"""

import tempfile
import time
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from cosim.base.config import ConfigError, require_one_of
from cosim.base.outcome import Outcome
from cosim.base.progress import Progress, silent
from cosim.base.provenance import versions
from cosim.base.scenario import Cell, Scenario, find_scenario
from cosim.navigation.batch import DRIVERS, CoSimulation, run_episode
from cosim.navigation.episode import Step, SupportsAct
from cosim.navigation.observing import draw_starts
from cosim.navigation.options import Driving
from cosim.reading.episode import Episode, read_episode
from cosim.recording.episode import EpisodeRecorder
from cosim.recording.levels import DETAILS, Level, with_bursts

_DIGITS = 6  # of lengths in cm and energies in J; times have ticks of 1e-5 s


class EpisodeResult(msgspec.Struct, frozen=True):
    """One episode as `summary.json` and the results of an evaluation list it.

    Attributes:
        outcome: how it ended.
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


def simulate(
    scenario: str | Path | Scenario,
    policy: SupportsAct,
    *,
    seed: int = 0,
    driver: str = "compiled",
    record: Level = "default",
    motor_fmu: str | Path | None = None,
    progress: Progress = silent,
    **options: Any,
) -> Episode:
    """Simulate one episode: the first one of `python -m cosim.run --seed SEED`.

    Args:
        scenario: name of a built-in scenario, scenario file (.toml) or record.
        policy: asked every 2 s of simulated time.
        seed: of start cells and speed noise.
        driver: compiled, reference or adaptive, see `python -m cosim.run --help`.
        record: summary, default or full: how much of the episode is kept.
        motor_fmu: of every motor, the built-in one by default.
        progress: is told the simulated time.
        options: physics by the names of `python -m cosim.run`, see `Driving`: `mu`, `noise`,
            `speed` (mm/s), `dt` (s), `time_limit` (s), `safety_margin` (m) and so on.

    Returns:
        Outcome, moves, parameters and every signal, with its recording in a temporary folder that
        lives as long as the record; `save` keeps it.

    Raises:
        ConfigError: an option is unknown or does not fit.
        ScenarioError: there is no such scenario.
        UserError: of the policy (trained on another scenario), the FMU or the calibration.
    """
    if not isinstance(scenario, Scenario):
        scenario = find_scenario(str(scenario))
    require_one_of("driver", driver, DRIVERS)
    require_one_of("record", record, DETAILS)
    if seed < 0:
        raise ConfigError(f"seed = {seed} must not be negative")
    known = [field.name for field in fields(Driving)]
    for name in options:
        if name not in known:
            raise ConfigError(f"simulate has no option {name}; choose from {', '.join(known)}")
    require = getattr(policy, "require_scenario", None)
    if require is not None:
        require(scenario)
    driving = Driving(motor_fmu=None if motor_fmu is None else Path(motor_fmu), **options)
    config, fmu = driving.prepare(scenario.robot_diameter_m, progress)
    config = with_bursts(config, record)
    starts, noise_seed = draw_episode(scenario, seed, 0)
    system = CoSimulation(scenario, fmu, config, driver)

    def watch(step: Step) -> None:
        limit_s = system.time_s if step.outcome else config.timing.episode_limit_s
        progress("simulating", system.time_s, limit_s, f"{system.time_s:.0f} s {step.outcome}")

    folder = tempfile.TemporaryDirectory(prefix="minirobots-")
    path = Path(folder.name) / "episode.rrd"
    facts = episode_facts(scenario, seed, fmu, 0, starts, driver)
    maps = getattr(policy, "maps", list)
    with EpisodeRecorder(
        path, scenario, config, f"{scenario.name}-{seed}-0", facts, level=record, policies=maps()
    ) as recorder:
        simulate_episode(system, policy, starts, noise_seed, recorder, watch)
    return read_episode(path, folder)


def episode_facts(
    scenario: Scenario,
    seed: int,
    fmu: Path,
    number: int,
    starts: tuple[Cell, ...],
    driver: str = "compiled",
) -> dict[str, Any]:
    """What identifies an episode in its recording, by name."""
    return {
        "scenario": scenario.name,
        "title": scenario.title,
        "seed": seed,
        "driver": driver,
        "motor_fmu": fmu.name,
        "versions": versions(),
        "episode": number,
        "starts": starts,
    }


def draw_episode(
    scenario: Scenario, seed: int, number: int
) -> tuple[tuple[Cell, ...], np.random.SeedSequence]:
    """Start cells, and seed of the speed noise, of an episode of a seeded series."""
    start_seed, noise_seed = np.random.SeedSequence(seed, spawn_key=(number,)).spawn(2)
    return draw_starts(scenario, np.random.default_rng(start_seed)), noise_seed


def simulate_episode(
    system: CoSimulation,
    policy: SupportsAct,
    starts: tuple[Cell, ...],
    noise_seed: np.random.SeedSequence,
    recorder: EpisodeRecorder | None = None,
    watch: Callable[[Step], None] = lambda _: None,
) -> EpisodeResult:
    """Run one episode and measure it.

    Args:
        system: may have run other episodes before.
        policy: acts; what it says of values and rewards is recorded.
        starts: start cell of each robot.
        noise_seed: of the speed noise.
        recorder: gets every RL step.
        watch: sees every RL step; may raise to end the episode.

    Raises:
        UserError: of an FMU or of the recording.
    """
    began = time.perf_counter()
    q_values, reward_parts = (getattr(policy, name, None) for name in ("q_values", "reward_parts"))

    def observe(step: Step) -> None:
        watch(step)
        if recorder is not None:
            parts = reward_parts and reward_parts(step, system.arrived)
            recorder.write(step, q_values and q_values(step.before), parts)

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

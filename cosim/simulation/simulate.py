"""One episode of a policy in the co-simulation as a record, for programs and notebooks.

Commands run many episodes through `cosim.simulation.tasks`.
A policy is anything with `act(observation)`, which returns directions (N,) or a `Decision` with
their action values (N, 8), or with `drive(motion)`, see `cosim.simulation.driving`. Values are
recorded, as are `reward_parts(step, arrived)` (N, 3) and `maps()` of a policy that has them, see
`agent.mdp.greedy`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.arguments import ConfigError
from cosim.base.progress import Progress, automatic, showing, silent
from cosim.base.provenance import versions
from cosim.coupling.rl_step import Step, SupportsAct, sampled_of
from cosim.model.scenario import Cell, Scenario
from cosim.model.world import World
from cosim.onboard.observing import draw_starts
from cosim.recording.file import Kept
from cosim.recording.reader import Episode, read_episode
from cosim.recording.series import warn_of_size, with_bursts
from cosim.simulation.batch import chosen_driver
from cosim.simulation.driving import SupportsDrive, needs_calibration, options_for
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.options import EpisodeOptions, options_of, resolve
from cosim.simulation.tasks import Record, Task, simulate_tasks
from fmus.build import identity_of_fmu


@showing
def simulate(
    scenario: str | Path | Scenario,
    policy: SupportsAct | SupportsDrive,
    *,
    world: str | Path | World | Mapping[str, Any] | None = None,
    progress: Progress | None = automatic,
    **options: Any,
) -> Episode:
    """Simulate one episode: the first one of `minirobots run --seed SEED`.

    >>> import minirobots as mr
    >>> class Upwards:
    ...     def act(self, observation):
    ...         return [2] * len(observation.cells)
    >>> mr.simulate("2", Upwards(), record="summary", progress=None).outcome
    'out_of_board'

    Args:
        scenario: name of a built-in scenario, scenario file (.toml) or record.
        policy: asked every 2 s of simulated time; or, one that commands motors, at the end of
            its control interval, see `cosim.simulation.driving`.
        world: world file (.toml), record or dict of its fields; by default that of the scenario
            file, or the paper's.
        progress: receives the simulated time; by default it is shown on stderr if the call takes
            more than two seconds. None shows nothing.
        options: of `minirobots run`, see `EpisodeOptions`: `seed`, `mu`, `noise`, `speed` (mm/s),
            `dt` (s), `time_limit` (s), `motor_fmu`, `record`, `driver` and so on.

    Returns:
        Outcome, moves, parameters and every signal, in memory; `save` writes the recording.

    Raises:
        UserError: an option is unknown or does not fit, there is no such scenario, or it is of the
            policy (trained on another scenario), the FMU or the calibration.
    """
    report = progress or silent
    chosen = options_of("simulate", options, kind=EpisodeOptions)
    record, seed = chosen.record, chosen.seed
    if record == "none":
        raise ConfigError("record = 'none' keeps nothing of the episode; choose another record")
    driving = options_for(policy, chosen)
    require = getattr(policy, "require_scenario", None)
    how = {"world": world, "require": require, "calibrate": needs_calibration(policy)}
    scenario, config, fmu = resolve(driving, scenario, report, **how)
    if warn := getattr(policy, "warn_of_machine", None):
        warn(config)
    config = with_bursts(config, record)
    driver = chosen_driver(chosen.driver, fmu, config)
    starts, noise_seed = draw_episode(scenario, seed, 0)

    def watch(step: Step, episode: RunningEpisode, _: float) -> None:
        limit_s = episode.time_s if step.outcome else config.timing.episode_limit_s
        state = f"{episode.time_s:.0f} s {step.outcome}"
        report("simulating", episode.time_s, limit_s, state)

    kept, sampled = Kept(), sampled_of(scenario.robots, chosen.signals)
    warn_of_size(config, record, len(sampled))
    facts = run_facts(scenario, seed, fmu, driver) | {"episode": 0, "starts": starts}
    how = Record(kept, facts, record), watch, driver, sampled
    task = Task(scenario, fmu, config, policy, starts, noise_seed, *how)
    report("simulating", 0.0, config.timing.episode_limit_s)  # kernels may be compiled first
    for _ in simulate_tasks([task], 1):
        pass
    return read_episode(kept)


def run_facts(scenario: Scenario, seed: int, fmu: Path, driver: str = "compiled") -> dict[str, Any]:
    """Return what identifies a run in its recordings, by name."""
    return {
        "scenario": scenario.name,
        "title": scenario.title,
        "seed": seed,
        "driver": driver,
        "motor_fmu": fmu.name,
        "motor_fmu_digest": identity_of_fmu(fmu),
        "versions": versions(),
    }


def draw_episode(
    scenario: Scenario, seed: int, number: int
) -> tuple[tuple[Cell, ...], np.random.SeedSequence]:
    """Start cells, and seed of the speed noise, of an episode of a seeded series."""
    key = number + (number > 0)  # not 1: evaluations draw their noise from that key
    start_seed, noise_seed = np.random.SeedSequence(seed, spawn_key=(key,)).spawn(2)
    return draw_starts(scenario, np.random.default_rng(start_seed)), noise_seed

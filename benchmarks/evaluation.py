"""Time `minirobots evaluate` for a sample of starts, against the same episodes one by one.

One side is what the command does: batches of episodes in lanes, all motors in one FMU instance. The
other, the scalar path, moves one body after the other and has an FMU instance for every motor. Both
run in as many threads of one process, and must give the same results. Half of the scalar episodes
run before the batches and half of them after, so that both sides meet the same machine.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import msgspec

import agent
from agent.evaluation.cases import Case, Job, run_jobs
from benchmarks.timing import times_s
from cosim.base.command import workers
from cosim.simulation.cosimulation import CoSimulation, run_episode
from cosim.simulation.options import SimulationOptions, resolve
from cosim.simulation.result import EpisodeResult, result_of
from cosim.simulation.tasks import compile_kernels
from fmus.build import cached_fmu
from minirobots.options import CommandOptions, Count, Jobs

Results = dict[int, EpisodeResult]


class Options(CommandOptions):
    scenario: str = "2"
    """Scenario; the policy is trained by the method paper, or found in the cache."""
    starts: Count = 48
    """Episodes of the evaluation."""
    scalar_starts: Count = 24
    """Those of them to be simulated one by one as well."""
    jobs: Jobs = 1


def scalar_system(job: Job) -> CoSimulation:
    """One body after the other, an FMU instance for every motor."""
    task = job.task()
    return CoSimulation(task.scenario, cached_fmu("VibrationMotor"), task.config, lanes=1)


def simulate_alone(job: Job) -> EpisodeResult:
    """The episode on the scalar path; its realtime_factor means nothing."""
    task, system = job.task(), scalar_system(job)
    run_episode(system, job.case.policy, task.starts, task.seed, lambda _: None)
    result = result_of(system.episode, task.starts, wall_s=1.0)
    system.close()
    return result


def robot_seconds(results: Results) -> float:
    """Simulated time of all robots."""
    return sum(result.sim_time_s * len(result.starts) for result in results.values())


def measure(options: Options) -> dict[str, float]:
    policy, threads = agent.train(options.scenario, method="paper"), workers(options.jobs)
    _, config, fmu = resolve(SimulationOptions(), policy.config.scenario)
    case = Case(policy, config, fmu, seed=0)
    episodes = [Job(case, index) for index in case.sample(options.starts)]
    compile_kernels(episodes[0].task(), options.starts, threads)
    scalar_system(episodes[0]).compile()
    results: Results = {}
    alone: Results = {}

    def in_batches() -> None:
        results.update((job.index, result) for job, result in run_jobs(episodes, threads))

    def one_by_one(some: Sequence[Job]) -> None:
        with ThreadPoolExecutor(threads) as pool:
            done = pool.map(simulate_alone, some)
            alone.update(zip((job.index for job in some), done, strict=True))

    half = options.scalar_starts // 2
    scalar_s = times_s(lambda: one_by_one(episodes[:half]))
    batch_s = times_s(in_batches)
    scalar_s += times_s(lambda: one_by_one(episodes[half : options.scalar_starts]))
    for index, result in alone.items():
        factor = result.realtime_factor
        if msgspec.structs.replace(results[index], realtime_factor=factor) != result:
            raise AssertionError(f"start {index}: {results[index]} in a batch, {result} alone")
    speed, scalar_speed = robot_seconds(results) / batch_s, robot_seconds(alone) / scalar_s
    end_to_end, of_processor_time = (speed / scalar_speed).tolist()
    return {
        "starts": len(results),
        "scalar_starts": len(alone),  # of them, with the same results one by one
        "threads": threads,
        "robot_seconds": robot_seconds(results),
        "robot_seconds_per_s": float(speed[0]),
        "scalar_robot_seconds_per_s": float(scalar_speed[0]),
        "ratio_end_to_end": end_to_end,
        # of all threads: holds on a busy machine too, but leaves out threads that wait
        "ratio_processor_time": of_processor_time,
    }

"""Many independent tasks on the cores of this machine or of a cluster, through joblib's backends.

Results come as they are ready; a worker that dies costs its own tasks another try and nothing
else. What a task does is the caller's: here is nothing about learning.
"""

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import joblib
from joblib.externals.loky.process_executor import BrokenProcessPool

from agent.training.settings import Backend
from cosim.base.errors import UserError

ATTEMPTS = 4  # of a task whose worker died; a task that kills every worker should not run for ever

CONNECT_TIMEOUT_S = 10.0  # to a cluster's head


class SweepError(UserError):
    """A sweep that cannot go on; the message says what to mend."""


def sweep(
    function: Callable[[Any], Any],
    tasks: Sequence[Any],
    *,
    jobs: int = -1,
    backend: Backend = "loky",
    address: str | None = None,
) -> Iterator[tuple[int, Any]]:
    """Call a function on every task in parallel.

    Args:
        function: called in a worker; its results must be picklable.
        tasks: its arguments.
        jobs: workers at once; -1 for one per core.
        backend: "loky" (processes) and "threading" on this machine; "ray" and "dask" on a cluster.
        address: of the cluster's head; by default a cluster of this machine is started.

    Yields:
        (index of the task, its result), in the order of completion.

    Raises:
        SweepError: the backend is not installed or cannot be reached, has no address, or workers
            keep dying.
    """
    if address is not None and backend in {"loky", "threading"}:
        raise SweepError(f"--address has no effect with --backend {backend}; name ray or dask")
    if address is not None and backend == "dask" and jobs != -1:
        raise SweepError("--jobs has no effect on a Dask cluster with an --address; leave it out")
    remaining = dict(enumerate(tasks))
    if jobs == 1 and backend in {"loky", "threading"}:
        yield from ((index, function(task)) for index, task in remaining.items())
        return
    with _backend(backend, jobs, address) as deaths:
        for _ in range(ATTEMPTS):
            calls = [joblib.delayed(_numbered)(function, *item) for item in remaining.items()]
            try:
                for index, result in _results(backend, jobs, calls):
                    del remaining[index]
                    yield index, result
            except deaths:
                continue  # what is left is tried again with new workers
            return
    raise SweepError(
        f"workers died {ATTEMPTS} times, {len(remaining)} of {len(tasks)} runs are missing; give "
        "them more memory or fewer jobs, the same command goes on"
    )


def _results(backend: Backend, jobs: int, calls: list[Any]) -> Iterator[Any]:
    if backend != "ray":
        yield from joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")(calls)
        return
    # Ray's backend cannot hand out results one by one: a wave of one task per worker at a time,
    # so that a death costs one wave
    with joblib.Parallel(n_jobs=jobs) as parallel:
        wave = joblib.effective_n_jobs(jobs)
        for first in range(0, len(calls), wave):
            yield from parallel(calls[first : first + wave])


def _numbered(function: Callable[[Any], Any], index: int, task: Any) -> tuple[int, Any]:
    return index, function(task)


@contextlib.contextmanager
def _backend(
    name: Backend, jobs: int, address: str | None
) -> Iterator[tuple[type[BaseException], ...]]:
    """Select a joblib backend; yields the exceptions that mean a dead worker."""
    if name == "ray":
        with _ray(jobs, address) as deaths, joblib.parallel_config("ray"):
            yield deaths
    elif name == "dask":
        with _dask(jobs, address) as deaths, joblib.parallel_config("dask"):
            yield deaths
    else:
        with joblib.parallel_config(name):
            yield (BrokenProcessPool,)


@contextlib.contextmanager
def _ray(jobs: int, address: str | None) -> Iterator[tuple[type[BaseException], ...]]:
    # workers have the project installed, as docs/cluster.md asks: below `uv run` Ray would pack it
    # and make an environment anew for every worker
    os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")
    try:
        import ray  # noqa: PLC0415 - optional
        from ray.exceptions import RayActorError, WorkerCrashedError  # noqa: PLC0415
        from ray.util.joblib import register_ray  # noqa: PLC0415
    except ImportError as error:
        raise SweepError("ray is not installed; run `uv sync --extra ray`") from error
    try:
        if address is None:
            cores = joblib.cpu_count() if jobs < 0 else jobs
            # "local": never a cluster that happens to run on this machine
            ray.init("local", num_cpus=cores, include_dashboard=False, log_to_driver=False)
        else:
            ray.init(address=address, log_to_driver=False)
    except ConnectionError as error:
        raise SweepError(f"no Ray cluster at {address}; check the address") from error
    register_ray()
    try:
        yield (RayActorError, WorkerCrashedError)
    finally:
        ray.shutdown()


@contextlib.contextmanager
def _dask(jobs: int, address: str | None) -> Iterator[tuple[type[BaseException], ...]]:
    try:
        import distributed  # noqa: PLC0415 - optional
        from distributed.scheduler import KilledWorker  # noqa: PLC0415
    except ImportError as error:
        raise SweepError("dask is not installed; run `uv sync --extra dask`") from error
    try:
        if address is None:
            cores = joblib.cpu_count() if jobs < 0 else jobs
            client = distributed.Client(
                n_workers=cores, threads_per_worker=1, dashboard_address=None
            )
        else:
            client = distributed.Client(address, timeout=CONNECT_TIMEOUT_S)
    except OSError as error:
        raise SweepError(f"no Dask scheduler at {address}; check the address") from error
    with client:
        yield (KilledWorker,)

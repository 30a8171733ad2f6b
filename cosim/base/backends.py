"""Many independent tasks on the cores of this machine or of a cluster, through joblib's backends.

Results come as they are ready; a worker that dies costs its own tasks another try and nothing
else. What a task does is the caller's.
"""

import contextlib
import itertools
import os
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import joblib
from joblib.externals.loky.process_executor import BrokenProcessPool

from cosim.base.errors import installing
from cosim.base.jobs import Backend, BackendError, Workers, always

ATTEMPTS = 4  # of a task after its worker died; a task that kills every worker must end

CONNECT_TIMEOUT_S = 10.0  # to a cluster's head


def sweep(
    function: Callable[[Any], Any],
    tasks: Sequence[Any],
    where: Workers,
    may_begin: Callable[[], bool] = always,
) -> Iterator[tuple[int, Any]]:
    """Call a function on every task in parallel.

    Args:
        function: called in a worker; its results must be picklable.
        tasks: its arguments.
        where: backend and number of workers.
        may_begin: whether another task may begin.

    Yields:
        (index of the task, its result), in the order of completion.

    Raises:
        BackendError: the backend is not installed or cannot be reached, or workers keep dying.
    """
    jobs, backend, address = where.jobs, where.backend, where.address
    remaining = dict(enumerate(tasks))
    if jobs == 1 and backend in {"loky", "threads"}:
        yield from ((k, function(task)) for k, task in remaining.items() if may_begin())
        return
    with _backend(backend, jobs, address) as deaths:
        for _ in range(ATTEMPTS):
            calls = (
                joblib.delayed(_numbered)(function, *item)
                for item in list(remaining.items())
                if may_begin()
            )
            try:
                for index, result in _results(backend, jobs, calls):
                    del remaining[index]
                    yield index, result
            except deaths:
                continue  # what is left is tried again with new workers
            return
    raise BackendError(
        f"workers died {ATTEMPTS} times, {len(remaining)} of {len(tasks)} tasks are missing; give "
        "them more memory or fewer jobs, the same command resumes"
    )


def _results(backend: Backend, jobs: int, calls: Iterator[Any]) -> Iterator[Any]:
    if backend != "ray":
        yield from joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")(calls)
        return
    # Ray's backend cannot hand out results one by one: a wave of one task per worker at a time,
    # so that a death costs one wave
    with joblib.Parallel(n_jobs=jobs) as parallel:
        wave = joblib.effective_n_jobs(jobs)
        while some := list(itertools.islice(calls, wave)):
            yield from parallel(some)


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
        with joblib.parallel_config("threading" if name == "threads" else name):
            yield (BrokenProcessPool,)


@contextlib.contextmanager
def _ray(jobs: int, address: str | None) -> Iterator[tuple[type[BaseException], ...]]:
    # workers have the project installed, as docs/cluster.md asks: below `uv run` Ray would pack it
    # and make another environment for every worker
    os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")
    try:
        import ray  # noqa: PLC0415 - optional
        from ray.exceptions import RayActorError, WorkerCrashedError  # noqa: PLC0415
        from ray.util.joblib import register_ray  # noqa: PLC0415
    except ImportError as error:
        raise BackendError(f"ray is not installed; run `{installing('ray')}`") from error
    try:
        if address is None:
            cores = joblib.cpu_count() if jobs < 0 else jobs
            # "local": never a cluster that happens to run on this machine
            ray.init("local", num_cpus=cores, include_dashboard=False, log_to_driver=False)
        else:
            ray.init(address=address, log_to_driver=False)
    except ConnectionError as error:
        raise BackendError(f"no Ray cluster at {address}; check the address") from error
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
        raise BackendError(f"dask is not installed; run `{installing('dask')}`") from error
    try:
        if address is None:
            cores = joblib.cpu_count() if jobs < 0 else jobs
            client = distributed.Client(
                n_workers=cores, threads_per_worker=1, dashboard_address=None
            )
        else:
            client = distributed.Client(address, timeout=CONNECT_TIMEOUT_S)
    except OSError as error:
        raise BackendError(f"no Dask scheduler at {address}; check the address") from error
    with client:
        yield (KilledWorker,)

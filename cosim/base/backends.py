"""Many independent tasks on the cores of this machine or of a cluster, through joblib's backends.

Results come as they are ready; a worker that dies costs its own tasks another try and nothing
else. What a task does is the caller's.
"""

import contextlib
import io
import itertools
import multiprocessing
import os
import re
import socket
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import joblib
from joblib.externals.loky.process_executor import BrokenProcessPool

from cosim.base.errors import UserError, installing
from cosim.base.jobs import Backend, Workers, always
from cosim.base.provenance import NotingPickler

ATTEMPTS = 4  # of a task after its worker died; a task that kills every worker must end

CONNECT_TIMEOUT_S = 10.0  # to a cluster's head
# Protocols of addresses; one without a protocol is of the first.
_SCHEMES = {"dask": ("tcp", "tls", "ws", "wss"), "ray": ("ray",)}


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
        UserError: the backend is not installed or cannot be reached, or workers keep dying.
    """
    jobs, backend, address = where.jobs, where.backend, where.address
    if address is not None and address != "auto":
        _require_listener(backend, address)
    remaining = dict(enumerate(tasks))
    if jobs == 1 and backend in {"loky", "threads"}:
        yield from ((k, function(task)) for k, task in remaining.items() if may_begin())
        return
    with contextlib.ExitStack() as stack:
        deaths: tuple[type[BaseException], ...] = (BrokenProcessPool,)
        if backend == "ray":
            deaths = stack.enter_context(_ray(jobs, address))
        elif backend == "dask":
            needed = _modules(function, tasks) if address else []
            deaths = stack.enter_context(_dask(jobs, address, needed))
        name = "threading" if backend == "threads" else backend
        stack.enter_context(joblib.parallel_config(name))
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
    raise UserError(
        f"workers died {ATTEMPTS} times, {len(remaining)} of {len(tasks)} tasks are missing; give "
        "them more memory or fewer jobs, the same command resumes"
    )


def _require_listener(backend: Backend, address: str) -> None:
    """Refuse an address at which nothing answers: the backends would try for minutes."""
    schemes = _SCHEMES[backend]
    found = re.fullmatch(r"(?:(\w+)://)?(\[[^]]+\]|[^/:\s]+):(\d{1,5})", address)
    if not found or (found[1] or schemes[0]) not in schemes:
        raise UserError(
            f"--address {address} is invalid; give HOST:PORT, as in {schemes[0]}://HOST:8786"
        )
    try:
        place = found[2].strip("[]"), int(found[3])
        socket.create_connection(place, CONNECT_TIMEOUT_S).close()
    except (OSError, OverflowError, UnicodeError) as error:
        raise UserError(
            f"no {backend.title()} cluster answers at {address}; check the address"
        ) from error


def _modules(*objects: Any) -> list[str]:
    """Return the names of modules that another process needs to read objects."""
    pickler = NotingPickler(io.BytesIO())
    with contextlib.suppress(Exception):  # what pickle cannot write, a backend may send by value
        pickler.dump(objects)
    return sorted(pickler.modules - {"__main__", "builtins"})


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
def _ray(jobs: int, address: str | None) -> Iterator[tuple[type[BaseException], ...]]:
    # workers have the project installed, as docs/studies.md asks: below `uv run` Ray would pack it
    # and make another environment for every worker
    os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")
    try:
        import ray  # noqa: PLC0415 - optional
        from ray.exceptions import RayActorError, WorkerCrashedError  # noqa: PLC0415
        from ray.util.joblib import register_ray  # noqa: PLC0415
    except ImportError as error:
        raise UserError(f"ray is not installed; run `{installing('ray')}`") from error
    try:
        if address is None:
            cores = joblib.cpu_count() if jobs < 0 else jobs
            # "local": never a cluster that happens to run on this machine
            ray.init("local", num_cpus=cores, include_dashboard=False, log_to_driver=False)
        else:
            ray.init(address=address, log_to_driver=False)
    except ConnectionError as error:
        raise UserError(f"no Ray cluster answers at {address}; check the address") from error
    register_ray()
    try:
        yield (RayActorError, WorkerCrashedError)
    finally:
        ray.shutdown()


@contextlib.contextmanager
def _dask(
    jobs: int, address: str | None, needed: list[str]
) -> Iterator[tuple[type[BaseException], ...]]:
    try:
        import distributed  # noqa: PLC0415 - optional
        from distributed.scheduler import KilledWorker  # noqa: PLC0415
    except ImportError as error:
        raise UserError(f"dask is not installed; run `{installing('dask')}`") from error
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        sys.exit(1)  # a worker that runs the user's script again, which started it
    try:
        if address is None:
            cores = joblib.cpu_count() if jobs < 0 else jobs
            client = distributed.Client(
                n_workers=cores, threads_per_worker=1, dashboard_address=None
            )
        else:
            client = distributed.Client(address, timeout=CONNECT_TIMEOUT_S)
    except OSError as error:
        raise UserError(f"no Dask cluster answers at {address}; check the address") from error
    except RuntimeError as error:
        raise UserError(
            f"Dask cannot start workers ({error}); in a script, make the call below "
            'if __name__ == "__main__":'
        ) from error
    with client:
        if address is not None:
            _require_workers(client, needed)
        yield (KilledWorker,)


def _require_workers(client: Any, names: list[str]) -> None:
    """Refuse a Dask cluster without workers, or without modules: it would never end."""

    def missing() -> list[str]:  # sent by value, as it is of no module's names
        import importlib  # noqa: PLC0415

        def lacks(name: str) -> bool:
            try:
                importlib.import_module(name)
            except ImportError:
                return True
            return False

        return [name for name in names if lacks(name)]

    try:
        client.wait_for_workers(1, CONNECT_TIMEOUT_S)
    except TimeoutError as error:
        raise UserError("the Dask cluster has no workers; start some") from error
    places = client.run(missing) | {"scheduler": client.run_on_scheduler(missing)}
    for place, lacking in places.items():
        if lacking:
            raise UserError(
                f"the cluster's {place} cannot import {lacking[0]}; install it on every machine, "
                "or add its folder to PYTHONPATH there"
            )

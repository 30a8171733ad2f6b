"""Many independent tasks on the cores of this machine or of a cluster, through joblib's backends.

Results come as they are ready; a worker that dies costs its own tasks another try and nothing
else. What a task does is the caller's.
"""

import contextlib
import multiprocessing
import os
import pickle
import re
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import joblib
from joblib.externals.loky.process_executor import BrokenProcessPool

from cosim.base.errors import UserError, installing
from cosim.base.jobs import Workers, always

ATTEMPTS = 4  # of a task after its worker died; a task that kills every worker must end
CONNECT_TIMEOUT_S = 10.0  # to a cluster's head
SCHEMES = ("tcp", "tls", "ws", "wss")  # protocols of a cluster's address; the first by default
_LOOK_S = 1.0  # time between two looks for the process that began this one
Deaths = tuple[type[BaseException], ...]


def sweep(
    function: Callable[[Any], Any],
    tasks: Sequence[Any],
    where: Workers,
    may_begin: Callable[[], bool] = always,
) -> Iterator[tuple[int, Any]]:
    """Call a function on every task in parallel; yields (index, result) as they are ready."""
    jobs, backend, address = where.jobs, where.backend, where.address
    remaining = dict(enumerate(tasks))
    if jobs == 1 and backend in {"loky", "threads"}:
        yield from ((k, function(task)) for k, task in remaining.items() if may_begin())
        return
    if address is not None:
        _require_listener(address)
    cluster: contextlib.AbstractContextManager[Deaths] = (
        _dask(where, (function, tasks))
        if backend == "dask"
        else contextlib.nullcontext((BrokenProcessPool,))
    )
    name = "threading" if backend == "threads" else backend
    own = {"initializer": end_with, "initargs": (os.getpid(),)} if backend == "loky" else {}
    with cluster as deaths, joblib.parallel_config(name, **own):
        for _ in range(ATTEMPTS):
            calls = (
                joblib.delayed(_numbered)(function, *item)
                for item in list(remaining.items())
                if may_begin()
            )
            try:
                parallel: Any = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")
                for index, result in parallel(calls):
                    del remaining[index]
                    yield index, result
            except deaths:
                continue  # what is left is tried again with new workers
            return
    raise UserError(
        f"workers died {ATTEMPTS} times, {len(remaining)} of {len(tasks)} tasks are missing; give "
        "them more memory or fewer jobs, the same command resumes"
    )


def end_with(parent: int) -> None:
    """Have this process end soon after its parent, even if that is killed without a word.

    A worker would wait for its next task for ever. Windows does not tell a process of it.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_LOOK_S)
        os._exit(1)

    if sys.platform != "win32":
        threading.Thread(target=watch, daemon=True).start()


def _require_listener(address: str) -> None:
    """Refuse an address at which nothing answers: Dask would try for minutes."""
    found = re.fullmatch(r"(?:(\w+)://)?(\[[^]]+\]|[^/:\s]+):(\d{1,5})", address)
    if not found or (found[1] or SCHEMES[0]) not in SCHEMES:
        raise UserError(
            f"--address {address} is invalid; give HOST:PORT, as in {SCHEMES[0]}://HOST:8786"
        )
    try:
        place = found[2].strip("[]"), int(found[3])
        socket.create_connection(place, CONNECT_TIMEOUT_S).close()
    except (OSError, OverflowError, UnicodeError) as error:
        raise _unanswered(address) from error


def _unanswered(address: str | None) -> UserError:
    return UserError(f"no Dask cluster answers at {address}; check the address")


def _numbered(function: Callable[[Any], Any], index: int, task: Any) -> tuple[int, Any]:
    return index, function(task)


@contextlib.contextmanager
def _dask(where: Workers, work: Any) -> Iterator[Deaths]:
    try:
        from distributed import Client  # noqa: PLC0415 - optional
        from distributed.scheduler import KilledWorker  # noqa: PLC0415
    except ImportError as error:
        raise UserError(f"dask is not installed; run `{installing('dask')}`") from error
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        sys.exit(1)  # a worker that runs the user's script again, which started it
    own = {"n_workers": joblib.effective_n_jobs(where.jobs), "threads_per_worker": 1}
    try:
        client = (
            Client(where.address, timeout=CONNECT_TIMEOUT_S)
            if where.address
            else Client(**own, dashboard_address=None)
        )
    except OSError as error:
        raise _unanswered(where.address) from error
    except RuntimeError as error:
        raise UserError(
            f"Dask cannot start workers ({error}); in a script, make the call below "
            'if __name__ == "__main__":'
        ) from error
    with client:
        if where.address is not None:
            _require_workers(client, work)
        yield (KilledWorker,)


def _require_workers(client: Any, work: Any) -> None:
    """Refuse a Dask cluster without workers, or that cannot import the work: it would never end."""
    content = b"N."  # None, in place of what only Dask can pickle
    with contextlib.suppress(Exception):
        content = pickle.dumps(work)

    def missing() -> str | None:  # sent by value, as it is of no module's names
        import pickle  # noqa: PLC0415

        try:
            pickle.loads(content)
        except ImportError as error:
            return error.name
        return None

    try:
        client.wait_for_workers(1, CONNECT_TIMEOUT_S)
    except TimeoutError as error:
        raise UserError("the Dask cluster has no workers; start some") from error
    places = client.run(missing) | {"scheduler": client.run_on_scheduler(missing)}
    for place, name in places.items():
        if name is not None:
            raise UserError(
                f"the cluster's {place} cannot import {name}; install it on every machine, "
                "or add its folder to PYTHONPATH there"
            )

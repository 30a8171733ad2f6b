"""Foreign FMUs in a process of their own, so that a fault ends a run with a one-line error.

An FMU is native code: it may crash, end the process or never return. A command with a foreign FMU
runs again as a child of itself, which leaves a note while a call into the FMU is under way; the
parent looks after the notes. This holds faults, not malice: the child may do what the user may.
"""

import atexit
import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NoReturn

import tyro

from cosim.base.errors import Terminated, at_end
from cosim.base.storage import CACHE, temporary_folder
from cosim.model.config import ConfigError

_NOTES = "MINIROBOTS_NOTES"  # folder of the notes, in the environment of a child
_ENDED = "ended"  # note of a child with complete results, with its exit status
_FAILED = "failed"  # note of what an FMU failed with
_LOOK_S = 0.1  # between two looks at the notes, and at the parent
_LIMIT_S = 300.0  # the reference driver may take a minute for an RL step
_MOST_WAITING = 256  # instances that are kept until results are complete
_waiting: deque[Callable[[], object]] = deque()


@dataclass(frozen=True, kw_only=True)
class Isolation:
    """Choice of whether FMUs run in a process of their own."""

    isolate: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Run in a process of its own, so that an FMU which crashes, ends the process or never returns
    is named with the simulated time. So does every command with FMUs that are not built in."""
    no_isolate: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Run FMUs that are not built in in the process of the command."""
    isolate_limit: Annotated[float | None, tyro.conf.arg(metavar="S")] = None
    """Wall-clock time in s that an isolated FMU may take for an RL step; by default 300."""

    def __post_init__(self) -> None:
        if self.isolate and self.no_isolate:
            raise ConfigError("--isolate contradicts --no-isolate; leave out one of them")
        if self.isolate_limit is not None and not self.isolate_limit > 0.0:
            raise ConfigError("--isolate-limit must be positive")

    def enter(self, module: str, foreign: Path | None) -> None:
        """Continue in a child process if FMUs are to be isolated: returns only where they may run.

        Args:
            module: of the command; its arguments are those of this process.
            foreign: FMU that is not built in, or archive of such, if any.

        Raises:
            ConfigError: what is said has no effect.
            FmuError: the child ended otherwise than by Python, or a call took too long.
            SystemExit: with the child's status.
        """
        if self.no_isolate and foreign is None:
            raise ConfigError("--no-isolate has no effect without --motor-fmu; leave it out")
        if self.no_isolate or (foreign is None and not self.isolate):
            if self.isolate_limit is not None:
                raise ConfigError("--isolate-limit has no effect without --isolate; leave it out")
        elif _NOTES in os.environ:
            at_end.append(note_end)
            atexit.register(lambda: None if _note(_ENDED).exists() else note_end(1))
            threading.Thread(target=_end_with_parent, args=(os.getppid(),), daemon=True).start()
        else:
            _run_in_child(module, foreign, self.isolate_limit or _LIMIT_S)


def note_end(status: int) -> None:
    """Note that results are complete: this exit status holds even if FMUs fail later."""
    if _NOTES in os.environ:
        _note(_ENDED).write_text(str(status))


def note_failure(message: str) -> None:
    """Note what an FMU failed with, which a crash in its end must not hide."""
    if _NOTES in os.environ:
        _note(_FAILED).write_text(message)


def isolated() -> bool:
    """Return whether this is the process of its own in which FMUs run."""
    return _NOTES in os.environ


def free_late(finalizer: weakref.finalize) -> None:
    """Free an instance at once; in a process of its own when results are complete.

    There a crash in the FMU's end would cost results that are not written yet.
    """
    if not isolated():
        finalizer()
    elif found := finalizer.detach():
        _, function, arguments, _ = found
        _waiting.append(lambda: function(*arguments))
        if len(_waiting) == 1:
            at_end.append(lambda _: _free_waiting(0))
        _free_waiting(_MOST_WAITING)


def _free_waiting(most: int) -> None:
    while len(_waiting) > most:
        _waiting.popleft()()


@contextlib.contextmanager
def calling(what: str) -> Iterator[None]:
    """While FMUs are called: leave a note, if a parent looks after it, and see what they change.

    The working directory is changed back.

    Args:
        what: is done by the calls, and when in simulated time.

    Raises:
        FmuError: an FMU changed how this thread computes with floating-point numbers.
    """
    name = f"{os.getpid()}-{threading.get_ident()}"
    note = _note(name) if _NOTES in os.environ else None
    if note is not None and (note.exists() or note.parent.joinpath(_ENDED).exists()):
        note = None
    if note is not None:
        note.write_text(what)
    try:
        with same_folder(), restored_arithmetic() as changed:
            yield
    finally:
        if note is not None:
            note.unlink()
    if changed:
        from cosim.fmi.fmu import FmuError  # noqa: PLC0415 - not for every --help

        raise FmuError(
            f"an FMU changed the rounding or the smallest numbers of the process in {what}, which "
            "makes all results wrong; export it without fesetround and -ffast-math"
        )


_FOLDER_LOCK = threading.Lock()
_folders: dict[int, str] = {}  # by thread, in which calls under way began


@contextlib.contextmanager
def same_folder() -> Iterator[None]:
    """Change back to the working directory in which this call began, or another thread's before it.

    An interrupt can leave a call without an end: what it knew does not count in its thread.
    """
    thread, folder = threading.get_ident(), None
    with _FOLDER_LOCK, contextlib.suppress(FileNotFoundError):  # it may be gone
        others = (there for other, there in _folders.items() if other != thread)
        _folders[thread] = folder = next(others, None) or os.getcwd()  # noqa: PTH109 - faster
    try:
        yield
    except GeneratorExit:
        folder = None  # it was left so, maybe long ago
        raise
    finally:
        with _FOLDER_LOCK, contextlib.suppress(OSError):
            _folders.pop(thread, None)
            if folder and os.getcwd() != folder:  # noqa: PTH109
                os.chdir(folder)


@contextlib.contextmanager
def restored_arithmetic() -> Iterator[list[bool]]:
    """Restore how this thread computes on leaving; the list then has an item if it was changed."""
    changed: list[bool] = []
    try:
        yield changed
    finally:
        half, tiny = 2.0**-53, sys.float_info.min
        usual = (1.0 + 0.75 * half, 1.0 + 1.5 * half, -1.0 - 0.75 * half, 0.5 * tiny * 2.0)
        if usual != (1.0, 1.0 + sys.float_info.epsilon, -1.0, tiny):
            changed.append(True)
            if sys.platform == "linux":
                ctypes.CDLL(None).fesetenv(ctypes.c_void_p(-1))  # FE_DFL_ENV of glibc


def _note(name: str) -> Path:
    return Path(os.environ[_NOTES]) / name


def _end_with_parent(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_LOOK_S)
    os._exit(1)


def _run_in_child(module: str, foreign: Path | None, limit_s: float) -> NoReturn:
    from cosim.fmi.fmu import FmuError  # noqa: PLC0415 - not for every --help

    fmu = "the built-in FMU"
    if foreign is not None:
        fmu = f"{'FMU' if foreign.suffix == '.fmu' else 'an FMU of'} {foreign.name}"
    with temporary_folder() as folder:
        notes = Path(folder)
        command = [sys.executable, "-m", *module.split(), *sys.argv[1:]]
        # A session of its own: Ctrl-C reaches it through its parent, once.
        # No path depends on the working directory, which an FMU may change.
        cache = {k: str(Path(v).absolute()) for k, v in os.environ.items() if k == CACHE and v}
        environment = os.environ | cache | {_NOTES: folder}
        with subprocess.Popen(command, env=environment, start_new_session=True) as child:
            late = _wait(child, notes, limit_s)
            with contextlib.suppress(ProcessLookupError):  # nothing of it is left
                if os.name == "nt":
                    child.kill()
                else:
                    os.killpg(child.pid, signal.SIGKILL)
        if (notes / _ENDED).exists():
            sys.exit(int((notes / _ENDED).read_text() or 0))
        failed = notes / _FAILED
        first = f"{failed.read_text()}; then " if failed.exists() else ""
        if late:
            raise FmuError(
                f"{first}{fmu} did not return from {late} within {limit_s:g} s; give it more by "
                "--isolate-limit, or export it again"
            )
        if child.returncode in {-signal.SIGINT, -signal.SIGTERM}:  # while it imported modules
            raise Terminated if child.returncode == -signal.SIGTERM else KeyboardInterrupt
        under_way = [note.read_text() for note in notes.iterdir() if note != failed]
        when = " and ".join(under_way) or "no call of ours"
        how = f"ended the process with status {child.returncode}"
        if child.returncode < 0:
            how = f"crashed ({signal.Signals(-child.returncode).name})"
        raise FmuError(f"{first}{fmu} {how} in {when}; export it again")


def _wait(child: subprocess.Popen, notes: Path, limit_s: float) -> str:
    """Until the child has ended; or what a call that takes too long was to do."""
    while True:
        try:
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(_LOOK_S)
                return ""
            for note in notes.iterdir():
                if note.name == _FAILED:
                    continue
                with contextlib.suppress(FileNotFoundError):  # the call has returned meanwhile
                    if time.time() - note.stat().st_mtime > limit_s:
                        return note.read_text() or "its end"
        except KeyboardInterrupt as interrupt:
            ended = isinstance(interrupt, Terminated)
            child.send_signal(signal.SIGTERM if ended or os.name == "nt" else signal.SIGINT)

"""Errors that the caller can fix, and how a command line reports them."""

import errno
import io
import os
import reprlib
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

USER_ERROR_STATUS = 2
INTERRUPTED_STATUS = 130
TERMINATED_STATUS = 143
BROKEN_PIPE_STATUS = 141
_BURST_S = 0.3  # in which signals are one request

_FIXES = {
    errno.ENOSPC: "the disk is full; free some space and run again",
    errno.EFBIG: "the file grows beyond the limit of this shell; raise it with ulimit -f",
    errno.EIO: "the disk does not answer as it should; choose another place",
    errno.EDQUOT: "the disk quota is used up; free some space and run again",
    errno.EACCES: "permission denied; choose another place or change its permissions",
    errno.EPERM: "permission denied; choose another place or change its permissions",
    errno.EROFS: "the file system is read-only; choose another place",
    errno.ENOENT: "no such file or folder; check the path",
    errno.ENOTDIR: "a part of the path is a file; choose another place",
    errno.EEXIST: "it exists and is not a folder; choose another place",
    errno.EISDIR: "it is a folder; name a file",
    errno.ENAMETOOLONG: "its name is longer than the file system allows; choose a shorter one",
    errno.EBADF: "the output is not open for writing; redirect it to a file or a pipe",
    errno.ELOOP: "a symbolic link leads back to itself; correct the link or choose another path",
}
_CLONE = Path(__file__).parents[2].joinpath("pyproject.toml").is_file()


class Terminated(KeyboardInterrupt):
    """SIGTERM, which ends a command as Ctrl-C does."""


class UserError(Exception):
    """A mistake that the caller can fix; the message is one line that names the thing and the fix.

    >>> import minirobots as mr
    >>> try:
    ...     mr.load("missing.npz")
    ... except mr.UserError as error:
    ...     print(error)
    missing.npz: no such policy file; name a policy.npz that training has saved
    """


class FileError(UserError):
    """A file that cannot be read or written; the message names it and the fix."""


def in_shell(command: str) -> str:
    """Return a command as users of this installation give it: in a clone with `uv run`."""
    return f"uv run {command}" if _CLONE else command


def installing(extra: str) -> str:
    """Return the command that installs an extra of this project."""
    return f"uv sync --extra {extra}" if _CLONE else f"pip install 'minirobots[{extra}]'"


def failure(what: str, error: BaseException, reason: str | None = None) -> UserError:
    """Return the error for a failure of a user's code, to be raised from that.

    Args:
        reason: by default what the failure says.
    """
    reason = f"{type(error).__name__}: {reason or error}"
    return UserError(f"{what} failed ({' '.join(reason.split())}); correct it")


def shorten(value: object) -> str:
    """Return a value as messages have it: shortened, on one line."""
    return " ".join(reprlib.repr(value).split())


def end_at_interrupt() -> None:
    """Let Ctrl-C end the process without a traceback until `run_command`, while it imports."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)


class _Interrupts:
    """Handler of SIGINT and SIGTERM while a command runs: the first one ends it.

    `timeout` and job systems send several at once, to a process and to its group. One that came
    while the command ends would leave locks held, and others wait for them. So a SIGTERM counts
    once; Ctrl-C counts again later, for an end that takes too long.
    """

    def __init__(self) -> None:
        self._last_s: float | None = None

    def __call__(self, number: int, _: object) -> None:
        before_s, self._last_s = self._last_s, time.monotonic()
        again = number == signal.SIGINT and before_s and self._last_s - before_s > _BURST_S
        if before_s is None or again:
            raise KeyboardInterrupt if number == signal.SIGINT else Terminated


def run_command(main: Callable[[], None]) -> None:
    """Run a command line's body and leave with its exit status.

    A `UserError` or an operating-system error becomes one line on stderr and status 2,
    Ctrl-C status 130; anything else is a defect and keeps its traceback. SIGTERM, as batch systems
    send it, does what Ctrl-C does (recordings are completed, temporary files removed), with status
    143.
    """
    interrupts = _Interrupts()
    signal.signal(signal.SIGTERM, interrupts)
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, interrupts)
    _open_streams()
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # some terminals have no µ
    try:
        try:
            main()
        finally:
            sys.stdout.flush()
    except BrokenPipeError:  # the reader of the output has ended, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(BROKEN_PIPE_STATUS)
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(USER_ERROR_STATUS)
    except OSError as error:
        if error.errno not in _FIXES:
            raise
        where = f"{error.filename}: " if error.filename else ""
        print(f"error: {where}{_FIXES[error.errno]}", file=sys.stderr)
        sys.exit(USER_ERROR_STATUS)
    except KeyboardInterrupt as interrupt:
        print("interrupted", file=sys.stderr)
        ended = isinstance(interrupt, Terminated)
        sys.exit(TERMINATED_STATUS if ended else INTERRUPTED_STATUS)


def _open_streams() -> None:
    """Have what goes to a stream that the shell has closed, as `>&-` does, go nowhere.

    A file that is opened later would get its number, and with it what libraries and children print.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):  # by their numbers
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), mode))

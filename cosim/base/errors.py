"""Errors that are the caller's to mend, and how a command line reports them."""

import errno
import os
import reprlib
import signal
import sys
from collections.abc import Callable

USER_ERROR_STATUS = 2
INTERRUPTED_STATUS = 130
TERMINATED_STATUS = 143
BROKEN_PIPE_STATUS = 141

_MENDS = {
    errno.ENOSPC: "the disk is full; free some space and run again",
    errno.EFBIG: "the file grows beyond the limit of this shell; raise it with ulimit -f",
    errno.EIO: "the disk does not answer as it should; choose another place",
    errno.EDQUOT: "the disk quota is used up; free some space and run again",
    errno.EACCES: "permission denied; choose another place or change its permissions",
    errno.EPERM: "permission denied; choose another place or change its permissions",
    errno.EROFS: "the file system is read-only; choose another place",
    errno.ENOENT: "no such file or folder; check the path",
    errno.ENOTDIR: "a part of the path is a file; choose another place",
    errno.EEXIST: "it exists and is no folder; choose another place",
    errno.EISDIR: "it is a folder; name a file",
    errno.ENAMETOOLONG: "its name is longer than the file system allows; choose a shorter one",
    errno.ELOOP: "a symbolic link leads back to itself; correct the link or choose another path",
}


class Terminated(KeyboardInterrupt):
    """SIGTERM, which ends a command as Ctrl-C does."""


class UserError(Exception):
    """A mistake the caller can mend; the message names the thing and the mend in one sentence."""


def shown(value: object) -> str:
    """Return a value as messages have it: shortened, on one line."""
    return " ".join(reprlib.repr(value).split())


def run_command(main: Callable[[], None]) -> None:
    """Run a command line's body and leave with its exit status.

    A `UserError` or an operating-system error becomes one sentence on stderr and status 2,
    Ctrl-C status 130; anything else is a defect and keeps its traceback. SIGTERM, as batch systems
    send it, does what Ctrl-C does (recordings are completed, temporary files removed), with status
    143.

    Args:
        main: the command; whatever it must keep on an interrupt it has saved by its own means.
    """
    signal.signal(signal.SIGTERM, _terminate)
    try:
        try:
            main()
        finally:
            sys.stdout.flush()
    except BrokenPipeError:  # whoever read the output has left, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(BROKEN_PIPE_STATUS)
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(USER_ERROR_STATUS)
    except OSError as error:
        if error.errno not in _MENDS:
            raise
        where = f"{error.filename}: " if error.filename else ""
        print(f"error: {where}{_MENDS[error.errno]}", file=sys.stderr)
        sys.exit(USER_ERROR_STATUS)
    except KeyboardInterrupt as interrupt:
        print("interrupted", file=sys.stderr)
        ended = isinstance(interrupt, Terminated)
        sys.exit(TERMINATED_STATUS if ended else INTERRUPTED_STATUS)


def _terminate(*_: object) -> None:
    raise Terminated

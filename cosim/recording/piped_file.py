"""A file that Rerun writes through a pipe, so that a write that fails is known here.

Rerun's own file writer ends at the first failed write with a line on stderr; what waits for it
afterwards may never return, and what it dropped is lost. Here it only ever writes to a
pipe, which is emptied whatever becomes of the file, and the file is written by plain Python; what
comes after a write that failed is thrown away. On Windows, where no pipe has a path,
Rerun writes the file.
"""

import contextlib
import errno
import os
import selectors
import threading
from pathlib import Path

from cosim.base.errors import FileError
from cosim.base.storage import lock_alone

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

_CHUNK_BYTES = 1 << 20


class PipedFile:
    """A file being written, and the pipe to write it through.

    Args:
        path: of the file.

    Attributes:
        address: path for the writer to open, before `opened` is called.

    Raises:
        OSError: the file cannot be opened.
        FileError: another process writes to it.
    """

    def __init__(self, path: Path) -> None:
        self._error: OSError | None = None
        self.address = str(path)
        self._thread = None
        if os.name == "nt":
            return
        self._file = path.open("ab", buffering=0)
        try:
            lock_alone(self._file, path)
        except FileError:
            self._file.close()
            raise
        self._file.truncate(0)
        self._reader, self._writer = os.pipe()
        os.set_blocking(self._reader, False)
        if fcntl is not None and hasattr(fcntl, "F_SETPIPE_SZ"):  # else it holds 64 kB
            with contextlib.suppress(PermissionError):  # to a user with many pipes
                fcntl.fcntl(self._writer, fcntl.F_SETPIPE_SZ, _CHUNK_BYTES)
        self.address = f"/dev/fd/{self._writer}"
        self._buffer = memoryview(bytearray(_CHUNK_BYTES))
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._empty, daemon=True)
        self._thread.start()

    def opened(self) -> None:
        """Leave the pipe to its writer; without one the file is complete."""
        if self._thread is not None:
            os.close(self._writer)

    def settle(self) -> None:
        """Have everything in the file that was written to the pipe so far.

        Raises:
            OSError: a write has failed, now or before.
        """
        if self._thread is not None:
            self._move()
        if self._error is not None:
            raise self._error

    def close(self, timeout_s: float) -> None:
        """Complete the file after its writer has closed the pipe.

        Raises:
            OSError: a write has failed, or the pipe is open after the time in s.
        """
        if self._thread is None:
            return
        self._thread.join(timeout_s)
        if self._thread.is_alive():
            raise TimeoutError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT))
        try:
            self._file.close()
        finally:
            os.close(self._reader)
        if self._error is not None:
            raise self._error

    def _empty(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._reader, selectors.EVENT_READ)
            while self._move():
                selector.select()

    def _move(self) -> bool:
        """Move data from the pipe to the file; False after its last writer has closed it."""
        with self._lock, contextlib.suppress(BlockingIOError):
            while count := os.readv(self._reader, [self._buffer]):
                self._write(self._buffer[:count])
            return False
        return True

    def _write(self, data: memoryview) -> None:
        try:
            while data and self._error is None:
                data = data[self._file.write(data) :]
        except OSError as error:
            self._error = error

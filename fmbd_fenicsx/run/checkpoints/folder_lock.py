"""One run at a time in a folder of checkpoints: a lock that ends with its process, and a note of whose it is."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import time as clock
from contextlib import suppress
from pathlib import Path

from ...errors import CheckpointError

LOCK = ".in_use"


class FolderLock:
    """Holds a folder for this process, until :meth:`release` or its end; not collective: the process that writes takes it.

    Raises:
        CheckpointError: another run holds it, which the message names.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / LOCK
        self._handle: int | None = None
        try:
            self._handle = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
            fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._failed(folder, error)
            return

        if os.fstat(self._handle).st_nlink == 0:  # its holder removed the file between the two lines above
            os.close(self._handle)
            self.__init__(folder)  # type: ignore[misc]
            return
        os.ftruncate(self._handle, 0)
        os.pwrite(self._handle, f"process {os.getpid()} on {socket.gethostname()} since {clock.ctime()}".encode(), 0)

    def _failed(self, folder: Path, error: OSError) -> None:
        """Somebody else's folder, one that cannot be written, or a file system without locks, where nobody can be kept out."""
        holder = ""
        if self._handle is not None:
            holder = os.pread(self._handle, 200, 0).decode(errors="replace")
            os.close(self._handle)
            self._handle = None

        if error.errno in (errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES) and holder:
            raise CheckpointError(
                f"The folder {folder} is in use by another run: {holder}. Wait for its end, or choose another folder."
            )
        if error.errno not in (errno.ENOLCK, errno.ENOTSUP, errno.EINVAL, errno.ENOSYS):
            raise CheckpointError(
                f"The folder {folder} of the checkpoints cannot be written: {error.strerror}. Choose another one."
            ) from error

    def release(self) -> None:
        """Let others in. A note that cannot be removed stays: the lock itself ends, and no other error is hidden by it."""
        if self._handle is not None:
            with suppress(OSError):
                self.path.unlink(missing_ok=True)
            os.close(self._handle)
            self._handle = None

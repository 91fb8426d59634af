"""The lock that keeps a second control process off a state directory."""

import errno
import fcntl
import hashlib
import os
import socket
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

_TEXT_LENGTH = 200


@contextmanager
def alone(state_dir: Path) -> Generator[None]:
    """Lock a state directory against other control processes while the context lasts.

    Without the lock, a second process would take the run of the first for interrupted, and latch on the disk, before it
    found the endpoint in use. There are two locks, which end with their process: a file, which keeps off processes in
    other containers, and a name in the kernel, which nobody can delete.

    Raises:
        OSError: another process has locked it, and the text names that process; or it cannot be written.
    """
    state_dir.mkdir(parents=True, exist_ok=True)
    path = hashlib.sha256(str(state_dir.resolve()).encode()).hexdigest()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as name, (state_dir / "lock").open("a+") as lock:
        try:
            name.bind(f"\0dsl-assembly {path}")
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if not isinstance(error, BlockingIOError) and error.errno != errno.EADDRINUSE:
                raise
            lock.seek(0)
            who = lock.read(_TEXT_LENGTH).strip()
            raise OSError(
                f"another control process uses {state_dir}{f' ({who})' if who else ''}: stop it, or give this cell a "
                "cell.state_dir of its own"
            ) from None
        lock.truncate(0)
        lock.write(f"process {os.getpid()} on {socket.gethostname()}\n")
        lock.flush()
        yield

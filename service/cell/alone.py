"""The lock that keeps a second control process off a state directory."""

import errno
import fcntl
import hashlib
import socket
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def alone(state_dir: Path) -> Generator[None]:
    """Lock a state directory against other control processes while the context lasts.

    Without the lock, a second process would take the run of the first for interrupted, and latch on the disk, before it
    found the endpoint in use. There are two locks, which end with their process: a file, which keeps off processes in
    other containers, and a name in the kernel, which nobody can delete.

    Raises:
        OSError: another process has locked it, or it cannot be written.
    """
    taken = f"another control process uses {state_dir}: stop it, or give this cell a cell.state_dir of its own"
    state_dir.mkdir(parents=True, exist_ok=True)
    path = hashlib.sha256(str(state_dir.resolve()).encode()).hexdigest()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as name, (state_dir / "lock").open("w") as lock:
        try:
            name.bind(f"\0dsl-assembly {path}")
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise OSError(taken) from None
        except OSError as error:
            raise OSError(taken if error.errno == errno.EADDRINUSE else str(error)) from error
        yield

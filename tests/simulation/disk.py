"""The disk under a state directory: real files, a slow `fsync`, and power cuts that lose what was not synced."""

import errno
import os
import random
from collections.abc import Callable
from pathlib import Path

from tests.simulation import clock


class Disk:
    """Watches one folder. `fsync` below it takes simulated time and makes durable; everything else is not durable yet.

    Attributes:
        latency_s: least and largest time of one `fsync`.
        hangs_until: no `fsync` returns before.
        full: whether `fsync` fails.
    """

    def __init__(self, folder: Path, chance: random.Random) -> None:
        self.folder = folder
        self.latency_s = (1e-4, 3e-3)
        self.hangs_until = 0.0
        self.full = False
        self._chance = chance
        self._synced: dict[int, bytes] = {}
        self._durable: dict[Path, bytes] = {}
        self._fsync: Callable[[int], None] = os.fsync

    @property
    def faulty(self) -> bool:
        """True while the disk is full or slow, and for one second after it hung."""
        return self.full or self.latency_s[1] > 0.02 or self.hangs_until > clock.here().process.loop.time() - 1.0

    def fsync(self, descriptor: int) -> None:
        """Stand in for `os.fsync`."""
        path = Path(os.readlink(f"/proc/self/fd/{descriptor}"))
        if not path.is_relative_to(self.folder):
            self._fsync(descriptor)
            return
        place = clock.here()
        now = place.process.loop.time()
        low, high = self.latency_s
        clock.sleep(max(low + (high - low) * self._chance.random(), self.hangs_until - now))
        if self.full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if path.is_dir():
            self._sync_folder(path)
        elif path.exists():  # else it was deleted under its writer
            inode = path.stat().st_ino
            self._synced[inode] = path.read_bytes()
            # A new file's entry is durable with its content, as on ext4, XFS and btrfs; a renamed one's is not.
            self._durable[path] = self._synced[inode]

    def cut_power(self) -> None:
        """Leave on the disk what was synced, and of later appended bytes as many as chance wants."""
        names = {path for path in self.folder.iterdir() if path.is_file() and "sqlite" not in path.name}
        for path in names | set(self._durable):
            present = path.read_bytes() if path.exists() else None
            durable = self._durable.get(path)
            if self._chance.random() < 0.3:
                left = present  # the kernel had written it back by itself
            elif durable is not None and present is not None and present.startswith(durable):
                left = present[: self._chance.randint(len(durable), len(present))]
            else:
                left = durable
            if left is None:
                path.unlink(missing_ok=True)
            elif left != present:
                path.write_bytes(left)
            if left is not None:
                self._durable[path] = left
            else:
                self._durable.pop(path, None)

    def _sync_folder(self, folder: Path) -> None:
        self._durable = {path: content for path, content in self._durable.items() if path.exists()}
        for path in folder.iterdir():
            if path.is_file() and (content := self._synced.get(path.stat().st_ino)) is not None:
                self._durable[path] = content

"""Atomic writing of files: a reader finds the old contents or the new ones."""

from collections.abc import Callable
from pathlib import Path


def write(path: Path, data: bytes) -> None:
    """Write a file, and make its folder."""
    write_by(path, lambda fresh: fresh.write_bytes(data))


def write_by(path: Path, writing: Callable[[Path], object]) -> None:
    """Let `writing` fill a file beside `path`, then move it to `path`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh = path.with_name(path.name + ".new")
    writing(fresh)
    fresh.replace(path)

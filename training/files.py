"""Atomic file writes: a reader finds either the old contents or the new ones."""

from collections.abc import Callable
from pathlib import Path


def write(path: Path, data: bytes) -> None:
    """Write a file, and create its folder."""
    write_by(path, lambda fresh: fresh.write_bytes(data))


def write_by(path: Path, writing: Callable[[Path], object]) -> None:
    """Let `writing` fill a new file beside `path`, then move that file to `path`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh = path.with_name(path.name + ".new")
    writing(fresh)
    fresh.replace(path)

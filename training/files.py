"""Files that are written as a whole: whoever reads one finds the old contents or the new ones."""

from collections.abc import Callable
from pathlib import Path


def write(path: Path, data: bytes) -> None:
    """Write a file, and the folder for it."""
    write_by(path, lambda fresh: fresh.write_bytes(data))


def write_by(path: Path, writing: Callable[[Path], object]) -> None:
    """Let `writing` fill a file beside `path`, which then takes its place."""
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh = path.with_name(path.name + ".new")
    writing(fresh)
    fresh.replace(path)

"""Optional compiled extensions: identity of their C sources, and loading.

`setup.py` runs this file by itself; it imports nothing of the project.
"""

import hashlib
from importlib import import_module
from pathlib import Path
from types import ModuleType


def digest(folder: Path) -> str:
    """Return the SHA-256 of the C files of a folder, names and content in sorted order."""
    found = hashlib.sha256()
    for path in sorted(folder.glob("*.[ch]")):
        data = path.read_bytes()
        found.update(f"{path.name} {len(data)}\n".encode() + data)
    return found.hexdigest()


def load(name: str, folder: Path) -> tuple[ModuleType | None, str]:
    """Load an extension that carries the digest of its sources as `SOURCES`.

    Args:
        name: its module.
        folder: folder of its present sources.

    Returns:
        The module and "", or None and the reason why it is not used.
    """
    try:
        found = import_module(name)
    except ImportError as error:
        return None, f"it is not built: {error}"
    if digest(folder) != found.SOURCES:
        return None, "it was built from other sources"
    return found, ""

"""Identity of the C sources, so that a build of earlier ones is not taken for the present one.

`setup.py` runs this file by itself; it imports nothing of the project.
"""

import hashlib
from pathlib import Path

FOLDER = Path(__file__).parent


def digest() -> str:
    """Return the SHA-256 of the C files of this folder, names and content in sorted order."""
    found = hashlib.sha256()
    for path in sorted(FOLDER.glob("*.[ch]")):
        data = path.read_bytes()
        found.update(f"{path.name} {len(data)}\n".encode() + data)
    return found.hexdigest()

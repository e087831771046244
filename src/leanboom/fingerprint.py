"""The fingerprint of the package's sources: what was made with other sources is not used again."""

from __future__ import annotations

import functools
import hashlib
from pathlib import Path

_FOLDER = Path(__file__).parent


@functools.cache
def fingerprint() -> str:
    """SHA-256 of the names and contents of all Python files of this package, in hexadecimal digits."""
    digest = hashlib.sha256()
    for path in sorted(_FOLDER.rglob("*.py")):
        content = path.read_bytes()
        digest.update(f"{path.relative_to(_FOLDER).as_posix()}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()

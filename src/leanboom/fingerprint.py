"""The fingerprint of the package's sources: what was made with other sources is not used again."""

from __future__ import annotations

import ast
import functools
import hashlib
from collections.abc import Iterator
from pathlib import Path

_FOLDER = Path(__file__).parent


@functools.cache
def fingerprint(module: str | None = None) -> str:
    """SHA-256 of the names and contents of Python files of this package, in hexadecimal digits.

    Args:
        module: A module of the package: its file counts, and those it imports anywhere, and so on. None: all files.
    """
    paths = _FOLDER.rglob("*.py") if module is None else needed(module)
    digest = hashlib.sha256()
    for path in sorted(paths):
        content = path.read_bytes()
        digest.update(f"{path.relative_to(_FOLDER).as_posix()}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()


def needed(module: str) -> set[Path]:
    """The files of a module of this package and of all modules of it that can be imported from there.

    Args:
        module: The module's name within the package.
    """
    found: set[Path] = set()
    waiting = [_FOLDER / f"{module}.py"]
    while waiting:
        path = waiting.pop()
        if path not in found:
            found.add(path)
            waiting += _imported(ast.parse(path.read_bytes()))
    return found


def _imported(tree: ast.Module) -> Iterator[Path]:
    """Files of this package that a module imports, at its top or in a function."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names] + [str(node.module)]
        else:
            continue
        for package, *parts in (name.split(".") for name in names):
            path = _FOLDER.joinpath(*parts)
            if package == "leanboom" and parts and path.with_suffix(".py").is_file():
                yield path.with_suffix(".py")
            elif package == "leanboom" and parts and path.is_dir():
                yield from path.rglob("*.py")

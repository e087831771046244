"""The fingerprint of a module: a hash of its sources and of all it imports."""

from __future__ import annotations

import functools
import hashlib
import re
from pathlib import Path

_FOLDER = Path(__file__).parent
_FROM = re.compile(r"^[ \t]*from +(leanboom[\w.]*) +import +(\([^)]*\)|.*)", re.MULTILINE)
_WORD = re.compile(r"\w+")
_NAMED = re.compile(r'"(leanboom(?:\.\w+)+):\w+"')  # imported when it is used
_IMPORT = re.compile(r"^[ \t]*import +(leanboom[^\n#]*)", re.MULTILINE)


@functools.cache
def fingerprint(module: str) -> str:
    """SHA-256 of the names and contents of the modules of `needed`, in hexadecimal digits.

    Args:
        module: A module's name within this package.
    """
    parts = [(name, _read(name)[0]) for name in sorted(needed(module))]
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def needed(module: str) -> set[str]:
    """The names of a module of this package and of all modules of it that can be imported from there.

    An import counts wherever it stands, also inside a function, or for the types alone.

    Args:
        module: The module's name within the package.
    """
    found: set[str] = set()
    waiting = {module}
    while waiting:
        found |= waiting
        waiting = set().union(*(_read(name)[1] for name in waiting)) - found
    return found


@functools.cache
def _modules() -> frozenset[str]:
    """Names of all modules within this package; one that is a folder by its `__init__`."""
    return frozenset(".".join(path.relative_to(_FOLDER).with_suffix("").parts) for path in _FOLDER.rglob("*.py"))


@functools.cache
def _read(module: str) -> tuple[bytes, frozenset[str]]:
    """A module's digest, and the modules that it imports. They are sought as text: this is done at every start."""
    content = _FOLDER.joinpath(*module.split(".")).with_suffix(".py").read_bytes()
    text = content.decode()
    names = set(_NAMED.findall(text))
    for package, what in _FROM.findall(text):
        names |= {package, *(f"{package}.{name}" for name in _WORD.findall(what))}
    for modules in _IMPORT.findall(text):
        names |= {part.split()[0] for part in modules.split(",") if part.strip()}
    within = {name.removeprefix("leanboom.") for name in names}
    within |= {f"{name}.__init__" for name in within}
    return hashlib.sha256(content).digest(), frozenset(within & _modules())

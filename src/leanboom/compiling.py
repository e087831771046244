"""How kernels are compiled: numba's `njit`, with compiled code kept in a folder that belongs to these very sources.

By itself numba keeps compiled code beside the sources and renews it when the file of a kernel changes. It misses a
change in a formula which the kernel calls from another file, and most of its own settings, and would run code that is
not there any more. So the folder's name holds a digest of all that, and every kernel module takes `njit` from here.
"""

from __future__ import annotations

import hashlib
import logging
import os
import re
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core import config, event

from leanboom.errors import InputError
from leanboom.fingerprint import fingerprint

VARIABLE = "NUMBA_CACHE_DIR"  # environment variable with the folder of compiled kernels
UNUSED = 7 * 86400.0  # [s], after which kernels of other sources are removed
_NAME = re.compile(r"leanboom-[0-9a-f]{16}")
_ASIDE = (VARIABLE, "NUMBA_NUM_THREADS")  # settings of numba that compiled code does not depend on

F = TypeVar("F", bound=Callable)

_settings: Any = config
_kernels: set[Callable] = set()  # all functions with the decorator `njit` below

Progress = Callable[[str, float], None]


def njit(**options: Any) -> Callable[[F], F]:
    """Numba's decorator of the same name, for the kernels of this package.

    Args:
        options: As numba has them.
    """

    def decorate(function: F) -> F:
        _kernels.add(function)
        others = _settings.CACHE_DIR  # that of other packages in this process
        _settings.CACHE_DIR = _FOLDER
        try:
            compiled: Any = numba.njit(**options)(function)
        finally:
            _settings.CACHE_DIR = others
        return compiled

    return decorate


@contextmanager
def told(tell: Progress) -> Iterator[None]:
    """Tell of every kernel that is compiled inside the `with` block; of those that are at hand, nothing.

    Args:
        tell: Called with what happens and the share done.
    """
    with event.install_listener("numba:compile", _Compilations(tell)):
        yield


class _Compilations(event.Listener):
    """Hears of functions that numba compiles."""

    def __init__(self, tell: Progress) -> None:
        self._tell = tell
        self._done: set[Callable] = set()

    def on_start(self, event: event.Event) -> None:
        """Tell how many kernels are compiled."""
        if _function(event) in _kernels:
            text = f"compiling kernels, which takes a minute or two once: {len(self._done)} of up to {len(_kernels)}"
            self._tell(text, 0.0)

    def on_end(self, event: event.Event) -> None:
        """Count a kernel; one compiled for several types counts once."""
        if (function := _function(event)) in _kernels:
            self._done.add(function)


def _function(event: event.Event) -> Callable:
    """The function that is compiled."""
    assert event.data is not None
    return event.data["dispatcher"].py_func


def _name() -> str:
    """Name of the folder for these sources, this numba and its settings."""
    settings = {name: value for name, value in os.environ.items() if name.startswith("NUMBA_") and name not in _ASIDE}
    parts = fingerprint(), numba.__version__, sys.version, sorted(settings.items())
    return f"leanboom-{hashlib.sha256(repr(parts).encode()).hexdigest()[:16]}"


def _folder() -> Path:
    """The folder of compiled kernels, which can be written.

    Raises:
        InputError: No folder can be written, not even a temporary one.
    """
    name = _name()
    try:
        base = Path(given) if (given := os.environ.get(VARIABLE)) else _user_folder()
        return _made(base / name)
    except (OSError, RuntimeError) as error:  # RuntimeError: the user has no home
        reason = getattr(error, "strerror", None) or str(error)
        refused = (
            f"compiled kernels cannot be kept in {getattr(error, 'filename', None) or 'the home folder'}: {reason}"
        )
    try:
        base = _temporary_folder()
        found = _made(base / name)
    except OSError:
        raise InputError(f"{refused}; set {VARIABLE} to a folder that can be written") from None
    # One line on standard error, unless a program that uses the package has other plans for it.
    logging.getLogger("leanboom").warning(
        "leanboom: %s; they are in %s now: set %s to a lasting folder that can be written", refused, base, VARIABLE
    )
    os.environ[VARIABLE] = str(base)  # for processes of this one, which need not warn again
    return found


def _user_folder() -> Path:
    """Where this system keeps what programs can make again, in a folder of ours."""
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "leanboom"


def _temporary_folder() -> Path:
    """A folder of this user alone: what others could write must not be run."""
    user = os.getuid() if hasattr(os, "getuid") else None  # temporary folders of Windows are a user's own
    folder = Path(tempfile.gettempdir()) / (f"leanboom-of-{user}" if user is not None else "leanboom")
    with suppress(OSError):
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        own = user is None or (found.st_uid == user and not found.st_mode & 0o022)
        if own and stat.S_ISDIR(found.st_mode):
            return folder
    return Path(tempfile.mkdtemp(prefix="leanboom-"))


def _made(folder: Path) -> Path:
    """A folder of kernels, made where it is missing, tried and marked as used; kernels out of use are removed."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=folder) as file:
        file.write(b"\0")
    os.utime(folder)
    for other in folder.parent.iterdir():
        if _NAME.fullmatch(other.name) and other != folder:
            with suppress(OSError):
                if time.time() - other.stat().st_mtime > UNUSED:
                    shutil.rmtree(other, ignore_errors=True)
    return folder


_FOLDER = str(_folder())

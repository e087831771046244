"""How kernels are compiled: numba's `njit`, with compiled code kept in a folder that belongs to these very sources.

By itself numba keeps compiled code beside the sources and renews it when the file of a kernel changes. It misses a
change in a formula which the kernel calls from another file, and most of its own settings, and would run code that is
not there any more. So each kernel module takes `njit` from here: the name of its folder is a digest of all that.
"""

from __future__ import annotations

import functools
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
        if options.get("cache"):
            _settings.CACHE_DIR = _folder(function.__module__.removeprefix("leanboom."))
        try:
            compiled: Any = numba.njit(**options)(function)
        finally:
            _settings.CACHE_DIR = others
        return compiled

    return decorate


@contextmanager
def told(tell: Progress) -> Iterator[None]:
    """Context that reports every kernel compiled inside the `with` block, not those loaded.

    Args:
        tell: Called with what happens and the share done.
    """
    with event.install_listener("numba:compile", _Compilations(tell)):
        yield


class _Compilations(event.Listener):
    """Listener to numba's compilation events."""

    def __init__(self, tell: Progress) -> None:
        self._tell = tell
        self._done: set[Callable] = set()

    def on_start(self, event: event.Event) -> None:
        """Report the number of kernels compiled so far."""
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


@functools.cache
def _folder(module: str) -> str:
    """The folder with the compiled code of a module: another one for other sources, numba or settings of it."""
    settings = {name: value for name, value in os.environ.items() if name.startswith("NUMBA_") and name not in _ASIDE}
    parts = module, fingerprint(module), numba.__version__, sys.version, sorted(settings.items())
    folder = _place() / f"leanboom-{hashlib.sha256(repr(parts).encode()).hexdigest()[:16]}"
    folder.mkdir(exist_ok=True)
    os.utime(folder)  # used now
    return str(folder)


@functools.cache
def _place() -> Path:
    """The writable folder for compiled code; code long out of use there is removed.

    Raises:
        InputError: No folder can be written, not even a temporary one.
    """
    try:
        return _tried(Path(given) if (given := os.environ.get(VARIABLE)) else _user_folder())
    except (OSError, RuntimeError) as error:  # RuntimeError: the user has no home
        where = getattr(error, "filename", None) or "the home folder"
        refused = f"compiled kernels cannot be kept in {where}: {getattr(error, 'strerror', None) or error}"
    try:
        place = _tried(_temporary_folder())
    except OSError:
        raise InputError(f"{refused}; set {VARIABLE} to a folder that can be written") from None
    # One line on standard error, unless a program that uses the package has other plans for it.
    logging.getLogger("leanboom").warning(
        "leanboom: %s; they are in %s now: set %s to a lasting folder that can be written", refused, place, VARIABLE
    )
    os.environ[VARIABLE] = str(place)  # for processes of this one, which need not warn again
    return place


def _user_folder() -> Path:
    """The system's cache folder for this package."""
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "leanboom"


def _temporary_folder() -> Path:
    """A temporary folder that only this user can write: code of others must not be run."""
    user = os.getuid() if hasattr(os, "getuid") else None  # temporary folders of Windows are a user's own
    folder = Path(tempfile.gettempdir()) / (f"leanboom-of-{user}" if user is not None else "leanboom")
    with suppress(OSError):
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        own = user is None or (found.st_uid == user and not found.st_mode & 0o022)
        if own and stat.S_ISDIR(found.st_mode):
            return folder
    return Path(tempfile.mkdtemp(prefix="leanboom-"))


def _tried(place: Path) -> Path:
    """A folder for compiled code, created if missing and tested for writing."""
    place.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=place) as file:
        file.write(b"\0")
    for folder in place.iterdir():
        if _NAME.fullmatch(folder.name):
            with suppress(OSError):
                if time.time() - folder.stat().st_mtime > UNUSED:
                    shutil.rmtree(folder, ignore_errors=True)
    return place

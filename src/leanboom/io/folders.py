"""Folders of results: reserved before the work begins, swept of what killed runs left, and written as a whole.

While a command works it holds a lock of the operating system on a hidden file. The system lets go of a lock when its
process ends, however it ends; so whoever holds the lock of a folder knows that hidden files and folders of earlier
runs belong to nobody any more.
"""

from __future__ import annotations

import hashlib
import os
import re
import secrets
import shutil
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO

from leanboom.errors import InputError

_LONG = 180  # [bytes] of a folder's name, of which the hidden names beside it are made
_PART = r"\.leanboom-new-[0-9a-f]{8}"  # a file that is written, inside its folder


def check(out: Path, allowed: Collection[str], ours: Callable[[Path], bool], kind: str) -> None:
    """Raise InputError if a place must not be replaced by a folder of results.

    Args:
        out: The place.
        allowed: Names of files that such a folder may hold.
        ours: Whether a folder that holds no others was written by leanboom.
        kind: What may be replaced, for the message.
    """
    with explained(out):
        if out.is_symlink():
            raise InputError(f"out = {out}; is a symbolic link: give the folder itself")
        if out.exists() and not out.is_dir():
            raise InputError(f"out = {out}; is a file: give a new or empty folder, or {kind}")
        if Path.cwd().is_relative_to(out.resolve()):
            raise InputError(f"out = {out}; is or holds the current folder: give one below or beside it")
        entries = sorted(out.iterdir()) if out.is_dir() else []
        strange = [path.name for path in entries if path.name not in allowed or path.is_symlink() or path.is_dir()]
        if strange or (entries and not ours(out)):
            holds = f"holds {strange[0]}" if strange else "was not written by leanboom"
            raise InputError(f"out = {out}; {holds}: give a new or empty folder, or {kind}")


@contextmanager
def reserved(out: Path) -> Iterator[None]:
    """Context that reserves a place for a folder that `put` will write there.

    Args:
        out: The place. Folders above it are made.

    Raises:
        InputError: The folder cannot be written there, or another run is about to.
    """
    with ExitStack() as until:
        with explained(out):
            place = out.resolve()
            until.enter_context(_folder(place.parent))
            if place.is_dir() and not os.access(place, os.W_OK):
                raise PermissionError(13, "it may not be replaced")
            if until.enter_context(_lock(out, place.with_name(f".{_label(place)}.leanboom-lock"))):
                _sweep(place)
        yield


@contextmanager
def opened(*outs: Path) -> Iterator[None]:
    """Context that reserves folders, made where they are missing, for files that `write` will put into them.

    Args:
        outs: The folders; one may be named twice.

    Raises:
        InputError: A folder cannot be written, or another run is at work there.
    """
    with ExitStack() as until:
        seen: set[Path] = set()
        for out in outs:
            with explained(out):
                until.enter_context(_folder(out))
                if out.resolve() not in seen and until.enter_context(_lock(out, out / ".leanboom-lock")):
                    for path in _matching(out, _PART):
                        path.unlink()
                seen.add(out.resolve())
        yield


def put(out: Path, contents: Mapping[str, bytes]) -> None:
    """Put a folder in its place; it appears as a whole or not at all, and what was there gives way.

    Args:
        out: The place.
        contents: The folder's files by name.

    Raises:
        InputError: The folder cannot be written.
    """
    with explained(out):
        place = out.resolve()  # renaming "." or "a/.." would not do what it says
        place.parent.mkdir(parents=True, exist_ok=True)
        new = _beside(place, "new")
        new.mkdir()
        try:
            for name, content in contents.items():
                (new / name).write_bytes(content)
            _replace(place, new)
        except BaseException:
            shutil.rmtree(new, ignore_errors=True)
            raise


def write(folder: Path, contents: Mapping[str, bytes]) -> None:
    """Write files into a folder beside others; each appears as a whole or not at all.

    Args:
        folder: The folder.
        contents: The files by name, which may begin with folders inside it.

    Raises:
        InputError: A file cannot be written.
    """
    with explained(folder):
        for name, content in contents.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            with whole(folder / name, folder) as new:
                new.write_bytes(content)


@contextmanager
def whole(file: Path, beside: Path | None = None) -> Iterator[Path]:
    """Context in which a new file is written, which then takes a file's place; nothing is left of it on an error.

    Args:
        file: The file.
        beside: The folder in which the new one is written; None: the file's own.

    Yields:
        The new file.
    """
    new = (beside or file.parent) / f".leanboom-new-{secrets.token_hex(4)}"
    try:
        yield new
        new.replace(file)
    except BaseException:
        with suppress(OSError):
            new.unlink()
        raise


@contextmanager
def explained(out: Path, what: str = "out", problem: str = "cannot be written") -> Iterator[None]:
    """Context that turns refusals of the system into an InputError on a folder.

    Args:
        out: The folder.
        what: What the folder is to the user.
        problem: What does not work.
    """
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        if isinstance(error, FileExistsError | NotADirectoryError):
            file = next((path for path in out.parents if path.exists() and not path.is_dir()), None)
            reason = reason if file is None else f"{file} is a file, not a folder"
        raise InputError(f"{what} = {out}; {problem}: {reason}") from None
    except (ValueError, RuntimeError) as error:  # a name no file can have, links in a circle
        raise InputError(f"{what} = {str(out)!r}; {problem}: {error}") from None


@contextmanager
def _folder(folder: Path) -> Iterator[None]:
    """Make a folder and those above it; in the end, remove those that were made and hold nothing."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        with suppress(OSError):
            for path in missing:
                path.rmdir()


@contextmanager
def _lock(out: Path, path: Path) -> Iterator[bool]:
    """Context that holds the lock of a file; False where the file system has none."""
    while True:
        file = path.open("ab")
        try:
            held = _take(file)
        except BlockingIOError:
            file.close()
            raise InputError(
                f"out = {out}; another run of leanboom writes there: wait until it ends, or give another folder"
            ) from None
        with suppress(OSError):  # whoever had the lock may have removed the file meanwhile
            if sys.platform == "win32" or os.path.samestat(os.fstat(file.fileno()), path.stat()):
                break
        file.close()
    try:
        yield held
    finally:
        with suppress(OSError):
            path.unlink()  # while it is locked, so that nobody waits for a file that is gone
        file.close()
        if sys.platform == "win32":  # where nothing open can be removed
            with suppress(OSError):
                path.unlink()


def _take(file: IO[bytes]) -> bool:
    """Lock a file; False where the file system has no locks. Raises BlockingIOError if another process has it."""
    if sys.platform == "win32":
        import msvcrt

        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError as error:
            raise BlockingIOError from error
        return True
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        return False
    return True


def _replace(place: Path, new: Path) -> None:
    """Put a new folder in its place; what was there returns if that fails."""
    if not place.exists():
        new.rename(place)
        return
    old = _beside(place, "old")
    place.rename(old)
    try:
        new.rename(place)
    except BaseException:
        with suppress(OSError):
            old.rename(place)
        raise
    with suppress(OSError):  # a folder named "old" is complete: one half removed must not be
        waste = _beside(place, "new")
        old.rename(waste)
        shutil.rmtree(waste, ignore_errors=True)


def _sweep(place: Path) -> None:
    """Remove what killed runs left beside a place; put an earlier folder back that one of them had set aside."""
    label = re.escape(_label(place))
    for old in _matching(place.parent, rf"\.{label}\.leanboom-old-[0-9a-f]{{8}}"):
        if place.exists():
            shutil.rmtree(old, ignore_errors=True)
        else:
            old.rename(place)
    for new in _matching(place.parent, rf"\.{label}\.leanboom-new-[0-9a-f]{{8}}"):
        shutil.rmtree(new, ignore_errors=True)


def _matching(folder: Path, pattern: str) -> list[Path]:
    return [path for path in folder.iterdir() if re.fullmatch(pattern, path.name)]


def _beside(place: Path, what: str) -> Path:
    return place.with_name(f".{_label(place)}.leanboom-{what}-{secrets.token_hex(4)}")


def _label(place: Path) -> str:
    """A folder's name, or a digest where the name leaves no room for more."""
    name = os.fsencode(place.name)
    return place.name if len(name) <= _LONG else hashlib.sha256(name).hexdigest()

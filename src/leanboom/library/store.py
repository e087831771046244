"""A library's folder: an index in SQLite, and the motions in Parquet; `docs/library.md` describes both.

Whatever is written appears as a whole or not at all. Motions are written to a new file first, then the index takes them
in, in one transaction; what the index does not name does not exist. So a build that ends at any moment, however it
ends, leaves a library that is whole. Readers never write.

The index holds the motions a second time, one a row: a file of Parquet is slow to take one of them out of. Readers use
the index alone, so files may be put together or removed while they read; a file that is damaged is written again.
"""

from __future__ import annotations

import hashlib
import os
import secrets
import sqlite3
from collections.abc import Iterable, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from leanboom.errors import InputError, LeanboomError
from leanboom.io import folders
from leanboom.model import motion
from leanboom.model.motion import Motion

if TYPE_CHECKING:
    import pyarrow as pa

INDEX, SEGMENTS, MACHINE, SPECIFICATION = "index.sqlite", "segments", "machine.yaml", "library.yaml"
ROWS = 64  # motions of a group in a file
FULL = 4096  # motions in a full file; files that hold less than half as many are put together

# Each entry leads an index from one format to the next; the format of an index is the number of entries it has had.
FORMATS = (
    """
    CREATE TABLE facts (name TEXT PRIMARY KEY, value TEXT NOT NULL);
    CREATE TABLE ways (
        id INTEGER PRIMARY KEY, shape TEXT NOT NULL,
        origin_x REAL, origin_y REAL, origin_z REAL, goal_x REAL, goal_y REAL, goal_z REAL,
        UNIQUE (shape, origin_x, origin_y, origin_z, goal_x, goal_y, goal_z));
    CREATE TABLE segments (
        id INTEGER PRIMARY KEY AUTOINCREMENT, file TEXT NOT NULL, rows INTEGER, size INTEGER, sha256 TEXT);
    CREATE TABLE motions (
        key TEXT PRIMARY KEY, machine TEXT NOT NULL, way INTEGER NOT NULL, pump TEXT NOT NULL, payload REAL,
        duration REAL, start TEXT, start_m REAL, solved INTEGER, status TEXT, energy_j REAL, pseudo_inverse_j REAL,
        solve_s REAL, segment INTEGER, row INTEGER) WITHOUT ROWID;
    """,
    """
    CREATE INDEX motions_of_way ON motions (way, pump, solved, payload, duration);
    CREATE INDEX motions_of_segment ON motions (segment);
    CREATE VIRTUAL TABLE near USING rtree (
        id, origin_x0, origin_x1, origin_y0, origin_y1, goal_x0, goal_x1, goal_y0, goal_y1, goal_z0, goal_z1);
    INSERT INTO near SELECT id, origin_x, origin_x, origin_y, origin_y, goal_x, goal_x, goal_y, goal_y, goal_z, goal_z
        FROM ways;
    """,
    """
    ALTER TABLE motions ADD COLUMN end_m REAL;
    CREATE TABLE velocities (
        key TEXT PRIMARY KEY, step REAL NOT NULL, start REAL NOT NULL, velocity BLOB NOT NULL);
    """,
)
FORMAT = len(FORMATS)


@dataclass(frozen=True, slots=True)
class Entry:
    """A motion as the index knows it."""

    key: str
    machine: str  # digest of the machine as this motion depends on it
    origin: tuple[float, float, float]  # [m]
    goal: tuple[float, float, float]  # [m]
    shape: str  # of its path, as JSON
    pump: str
    payload: float  # [kg]
    duration: float  # [s]
    start: str  # of the redundant cylinder, as asked for
    start_m: float | None  # where that is [m]
    end_m: float | None  # where it must end [m]; None where its end is free
    solved: bool
    status: str
    energy_j: float | None  # of its pump
    pseudo_inverse_j: float | None  # what the pseudo-inverse takes from the same start
    solve_s: float
    segment: int | None  # where its motion is; None where there is none
    row: int | None


class Choice(NamedTuple):
    """What a query looks at of a motion: made many times a query, so no more than a tuple."""

    key: str
    payload: float  # [kg]
    duration: float  # [s]
    start_m: float  # [m]
    energy_j: float  # [J]


_WAY = ("origin_x", "origin_y", "origin_z", "goal_x", "goal_y", "goal_z")
_OWN = (
    "key", "machine", "pump", "payload", "duration", "start", "start_m", "end_m", "solved", "status", "energy_j",
    "pseudo_inverse_j", "solve_s", "segment", "row",
)  # fmt: skip
_ASKED = ("way", "pump", "payload", "duration", "start")  # what one library holds one motion for
_EARLIER = " AND ".join(f"{name} = ?" for name in _ASKED) + " AND key <> ?"
_SELECT = (
    f"SELECT {', '.join(f'motions.{name}' for name in _OWN)}, {', '.join(_WAY)}, shape "
    "FROM motions JOIN ways ON ways.id = motions.way "
)
_VELOCITIES = "SELECT velocities.key, step, velocities.start, velocity FROM velocities"
_SQUARES = [f"(ways.{name} - ?{i}) * (ways.{name} - ?{i})" for i, name in enumerate(_WAY, 1)]
_BOX = ("origin_x", "origin_y", *_WAY[3:])
_NEAREST = (
    f"SELECT ways.id, max({' + '.join(_SQUARES[:3])}, {' + '.join(_SQUARES[3:])}) AS apart "
    "FROM near JOIN ways USING (id) WHERE "
    + " AND ".join(f"{name}0 <= ?{2 * i + 7} AND {name}1 >= ?{2 * i + 8}" for i, name in enumerate(_BOX))
    + " ORDER BY apart LIMIT 1"
)
_HELD, _PLACED = "SELECT key FROM velocities", "SELECT key FROM motions WHERE segment NOTNULL"
_NUMBERS = "<f8"


def arrow() -> Any:
    """The library that reads and writes Parquet.

    Raises:
        LeanboomError: It is not installed.
    """
    try:
        import pyarrow
    except ImportError:
        raise LeanboomError("motion libraries need pyarrow; install it with: pip install 'leanboom[library]'") from None
    return pyarrow


class Store:
    """An open library. One process at a time may write; `engine.build` holds the folder's lock meanwhile."""

    def __init__(self, folder: Path, *, write: bool = False):
        """Open a library.

        Args:
            folder: Its folder.
            write: Whether to write; then it is made where there is none.

        Raises:
            InputError: There is no library, its format is not known here, or it cannot be read.
        """
        self.folder = folder
        index = folder / INDEX
        if not write and not index.is_file():
            raise InputError(f"library = {folder}; holds no {INDEX}: make a library with leanboom library build")
        with self._explained():
            uri = f"{index.resolve().as_uri()}?mode={'rwc' if write else 'ro'}"
            self._index = sqlite3.connect(uri, uri=True, isolation_level=None, timeout=30.0)
            self._index.execute("PRAGMA synchronous = FULL")
            found = self._index.execute("PRAGMA user_version").fetchone()[0]
            if found > FORMAT:
                raise InputError(
                    f"library = {folder}; has format {found}, this leanboom reads up to {FORMAT}: use a newer leanboom"
                )
            if found < FORMAT and not write:
                raise InputError(f"library = {folder}; has the older format {found}: build it again to renew its index")
            for number in range(found, FORMAT):
                self._index.executescript(f"BEGIN; {FORMATS[number]} PRAGMA user_version = {number + 1}; COMMIT;")
        if write:
            (folder / SEGMENTS).mkdir(exist_ok=True)

    def close(self) -> None:
        """Close it."""
        self._index.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @contextmanager
    def _explained(self):
        """What SQLite and the system refuse, said as a problem of the library."""
        try:
            yield
        except sqlite3.DatabaseError as error:
            if "full" in str(error):
                raise InputError(
                    f"library = {self.folder}; cannot be written: no space left; what is in it stays"
                ) from None
            raise InputError(f"library = {self.folder}; its {INDEX} cannot be used: {error}") from None
        except OSError as error:
            raise InputError(
                f"library = {self.folder}; cannot be written: {error.strerror or error}; what is in it stays"
            ) from None

    @contextmanager
    def _transaction(self):
        """All of what is done within, or nothing."""
        with self._explained():
            self._index.execute("BEGIN IMMEDIATE")
            try:
                yield self._index
                self._index.execute("COMMIT")
            except BaseException:
                with suppress(sqlite3.Error):
                    self._index.execute("ROLLBACK")
                raise

    # --- facts ---

    def facts(self) -> dict[str, str]:
        """What is known of the library as a whole: `name`, `machine`, `leanboom`."""
        with self._explained():
            return dict(self._index.execute("SELECT name, value FROM facts"))

    def note(self, **facts: str) -> None:
        """Write facts."""
        with self._transaction() as index:
            index.executemany("INSERT OR REPLACE INTO facts VALUES (?, ?)", facts.items())

    # --- motions ---

    def keys(self) -> set[str]:
        """Keys of all motions, also of those without a solution."""
        with self._explained():
            return {key for (key,) in self._index.execute("SELECT key FROM motions")}

    def count(self) -> int:
        """Number of motions, also of those without a solution."""
        with self._explained():
            return self._index.execute("SELECT count(*) FROM motions").fetchone()[0]

    def entries(self, where: str = "", values: Sequence[Any] = ()) -> list[Entry]:
        """Motions of the index.

        Args:
            where: What follows `WHERE` and names columns of `motions` and `ways`; empty: all.
            values: Of its question marks.
        """
        with self._explained():
            rows = self._index.execute(
                _SELECT + (f"WHERE {where}" if where else "ORDER BY way, key"), values
            ).fetchall()
        return [_entry(row) for row in rows]

    def choices(self, way: int, pump: str) -> list[Choice]:
        """What there is to choose from along a way with a pump: motions that solve their tasks.

        Args:
            way: Number of the way.
            pump: "ls" or "cp".
        """
        select = "SELECT key, payload, duration, start_m, energy_j FROM motions WHERE way = ? AND pump = ?"
        with self._explained():
            return [Choice(*row) for row in self._index.execute(f"{select} AND segment NOTNULL", (way, pump))]

    def nearest_way(self, origin: Sequence[float], goal: Sequence[float], within: float) -> tuple[int, float] | None:
        """The way nearest to another one: its number, and the larger distance of their ends [m]; None if none is near.

        Args:
            origin, goal: Ends of the other way [m].
            within: Distance along every axis [m].
        """
        box = [edge for value in (*origin[:2], *goal) for edge in (value + within, value - within)]
        with self._explained():
            found = self._index.execute(_NEAREST, (*origin, *goal, *box)).fetchone()
        return None if found is None else (found[0], float(found[1]) ** 0.5)

    def add(self, entries: Sequence[tuple[Entry, Motion | None]]) -> None:
        """Write motions and what the index says of them; once this returns they are there to stay.

        Args:
            entries: What the index says, and the motion where there is one.

        Raises:
            InputError: They cannot be written; then none of them is.
        """
        kept = [(entry.key, each) for entry, each in entries if each is not None]
        with self._explained():
            segment = self._write(_table(kept)) if kept else None
        rows = {key: row for row, (key, _) in enumerate(kept)}
        with self._transaction() as index:
            number = None if segment is None else _named(index, segment)
            for entry, _ in entries:
                row = rows.get(entry.key)
                _insert(index, entry, None if row is None else number, row)
            _insert_velocities(index, kept)

    def motion(self, entry: Entry) -> Motion:
        """The motion of an entry.

        Raises:
            InputError: It is not there any more.
        """
        with self._explained():
            row = self._index.execute(f"{_VELOCITIES} WHERE key = ?", (entry.key,)).fetchone()
        if row is None:
            raise InputError(f"library = {self.folder}; a build has taken motion {entry.key} out: ask again")
        _, step, start, velocity = row
        return _moved(step, start, velocity, entry.pump)

    # --- care ---

    def damaged(self) -> list[int]:
        """Files that are missing or not as they were written, by number."""
        found = []
        with self._explained():
            segments = self._index.execute("SELECT id, file, size, sha256 FROM segments").fetchall()
        for number, file, size, digest in segments:
            path = self.folder / SEGMENTS / file
            if not path.is_file() or path.stat().st_size != size or _digest(path) != digest:
                found.append(number)
        return found

    def forget(self, machines: Iterable[str] | None = None) -> int:
        """Write damaged files again, and take out motions that are lost or of other machines.

        Args:
            machines: Digests of the machine; None: motions of all are kept.

        Returns:
            Number of motions taken out.
        """
        broken = self.damaged()
        self._fill(set(broken))
        with self._transaction() as index:
            before = index.execute("SELECT count(*) FROM motions").fetchone()[0]
            index.execute(f"DELETE FROM motions WHERE segment NOTNULL AND key NOT IN ({_HELD})")
            if machines is not None:
                known = list(machines)
                index.execute(f"DELETE FROM motions WHERE machine NOT IN ({', '.join('?' * len(known))})", known)
            index.execute(f"DELETE FROM velocities WHERE key NOT IN ({_PLACED})")
            index.execute("DELETE FROM segments WHERE id NOT IN (SELECT segment FROM motions WHERE segment NOTNULL)")
            after = index.execute("SELECT count(*) FROM motions").fetchone()[0]
        for number in broken:
            self._merge([number])
        self._tidy()
        return before - after

    def _fill(self, broken: set[int]) -> None:
        """Take motions into the index out of files, where it does not hold them: it was of an older format."""
        select = f"SELECT DISTINCT segment, file FROM motions JOIN segments ON id = segment WHERE key NOT IN ({_HELD})"
        with self._explained():
            found = self._index.execute(select).fetchall()
        for number, file in found:
            if number not in broken:
                from pyarrow import parquet

                read = _motions(parquet.read_table(self.folder / SEGMENTS / file))
                with self._transaction() as index:
                    _insert_velocities(index, read)

    def compact(self) -> None:
        """Put small files together, and motions that are still in use out of files that hold others."""
        select = (
            "SELECT id, rows, (SELECT count(*) FROM motions WHERE segment = segments.id) FROM segments WHERE rows < ? "
            "ORDER BY id"
        )
        with self._explained():
            small = self._index.execute(select, (FULL // 2,)).fetchall()
        if len(small) < 2:
            return
        batch: list[int] = []
        held = 0
        for number, _, used in small:
            batch.append(number)
            held += used
            if held >= FULL:
                self._merge(batch)
                batch, held = [], 0
        if len(batch) > 1:
            self._merge(batch)
        self._tidy()

    def _merge(self, segments: list[int]) -> None:
        """One file in place of several."""
        select = f"{_VELOCITIES} JOIN motions USING (key) WHERE segment = ? ORDER BY row"
        pieces = []
        with self._explained():
            for number in segments:
                rows = self._index.execute(select, (number,))
                pieces += [(key, _moved(step, start, velocity, "")) for key, step, start, velocity in rows]
        with self._explained():
            written = self._write(_table(pieces)) if pieces else None
        with self._transaction() as index:
            if written is not None:
                number = _named(index, written)
                places = [(number, row, key) for row, (key, _) in enumerate(pieces)]
                index.executemany("UPDATE motions SET segment = ?, row = ? WHERE key = ?", places)
            index.executemany("DELETE FROM segments WHERE id = ?", [(each,) for each in segments])

    def _tidy(self) -> None:
        """Remove files that the index does not name."""
        named = {file for (file,) in self._index.execute("SELECT file FROM segments")}
        for path in (self.folder / SEGMENTS).iterdir():
            if path.name not in named:
                with suppress(OSError):
                    path.unlink()

    def _write(self, table: pa.Table) -> tuple[str, int, int, str]:
        """Write a file of motions: its name, rows, size and digest."""
        from pyarrow import parquet

        name = f"{secrets.token_hex(8)}.parquet"
        with folders.whole(self.folder / SEGMENTS / name) as new:
            with new.open("wb") as file:
                parquet.write_table(table, file, row_group_size=ROWS, compression="none", use_dictionary=False)
                file.flush()
                os.fsync(file.fileno())
            size, digest = new.stat().st_size, _digest(new)
        return name, table.num_rows, size, digest


def _table(motions: Sequence[tuple[str, Motion]]) -> pa.Table:
    pyarrow = arrow()
    columns = {
        "key": pyarrow.array([key for key, _ in motions], pyarrow.string()),
        "step": pyarrow.array([each.step for _, each in motions], pyarrow.float64()),
        "start": pyarrow.array([float(each.position[0]) for _, each in motions], pyarrow.float64()),
        "velocity": pyarrow.array([each.velocity for _, each in motions], pyarrow.list_(pyarrow.float64())),
    }
    return pyarrow.table(columns)


def _motions(table: pa.Table) -> list[tuple[str, Motion]]:
    columns = (table.column(name).to_pylist() for name in ("key", "step", "start", "velocity"))
    return [
        (key, motion.from_velocities(step, start, np.array(velocity), "dp", ""))
        for key, step, start, velocity in zip(*columns, strict=True)
    ]


def _moved(step: float, start: float, velocity: bytes, pump: str) -> Motion:
    """A motion as the index holds it."""
    return motion.from_velocities(step, start, np.frombuffer(velocity, _NUMBERS).astype(np.float64), "dp", pump)


def _insert_velocities(index: sqlite3.Connection, motions: Iterable[tuple[str, Motion]]) -> None:
    rows = [
        (key, each.step, float(each.position[0]), each.velocity.astype(_NUMBERS).tobytes()) for key, each in motions
    ]
    index.executemany("INSERT OR REPLACE INTO velocities VALUES (?, ?, ?, ?)", rows)


def _entry(row: tuple) -> Entry:
    own = dict(zip(_OWN, row, strict=False))
    place = row[len(_OWN) :]
    own["solved"] = bool(own["solved"])
    return Entry(origin=place[:3], goal=place[3:6], shape=place[6], **own)


def _named(index: sqlite3.Connection, segment: tuple[str, int, int, str]) -> int:
    number = index.execute("INSERT INTO segments (file, rows, size, sha256) VALUES (?, ?, ?, ?)", segment).lastrowid
    assert number is not None
    return number


def _insert(index: sqlite3.Connection, entry: Entry, segment: int | None, row: int | None) -> None:
    place = (entry.shape, *entry.origin, *entry.goal)
    known = f"shape = ? AND {' AND '.join(f'{name} = ?' for name in _WAY)}"
    found = index.execute(f"SELECT id FROM ways WHERE {known}", place).fetchone()
    if found is None:
        made = index.execute(f"INSERT INTO ways (shape, {', '.join(_WAY)}) VALUES (?, ?, ?, ?, ?, ?, ?)", place)
        way = made.lastrowid
        ends = [value for each in (*entry.origin[:2], *entry.goal) for value in (each, each)]
        index.execute(f"INSERT INTO near VALUES ({', '.join('?' * 11)})", (way, *ends))
    else:
        (way,) = found
    earlier = [way, *(getattr(entry, name) for name in _ASKED[1:]), entry.key]  # those of another search
    index.execute(f"DELETE FROM velocities WHERE key IN (SELECT key FROM motions WHERE {_EARLIER})", earlier)
    index.execute(f"DELETE FROM motions WHERE {_EARLIER}", earlier)
    values = {name: getattr(entry, name) for name in _OWN} | {"segment": segment, "row": row, "way": way}
    names = ", ".join(values)
    index.execute(
        f"INSERT OR REPLACE INTO motions ({names}) VALUES ({', '.join('?' * len(values))})", tuple(values.values())
    )


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()

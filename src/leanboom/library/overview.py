"""What a library holds as a whole: counts, energies over the work area, what an hour of work costs; one file of all."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

from leanboom.errors import InputError
from leanboom.io import folders
from leanboom.library.store import FORMAT, Entry, Store, arrow

HOUR = 3600.0  # [s]


@dataclass(frozen=True, slots=True)
class Overview:
    """A library in numbers."""

    name: str
    machine: str
    format: int
    motions: int
    solved: int
    infeasible: int
    ways: int
    durations: tuple[float, ...]
    payloads: tuple[float, ...]
    pumps: tuple[str, ...]
    mean_energy_j: float | None
    mean_saving: float | None  # against the pseudo-inverse, of motions that have one
    size_bytes: int

    def json(self) -> dict[str, Any]:
        """The numbers as `--json` has them."""
        return asdict(self)


def overview(store: Store) -> Overview:
    """What a library holds.

    Args:
        store: The open library.
    """
    entries, facts = store.entries(), store.facts()
    solved = [each for each in entries if each.solved]
    savings = [share for each in solved if (share := saving(each)) is not None]
    return Overview(
        name=facts.get("name", ""),
        machine=facts.get("machine", ""),
        format=FORMAT,
        motions=len(entries),
        solved=len(solved),
        infeasible=len(entries) - len(solved),
        ways=len({(each.origin, each.goal, each.shape) for each in entries}),
        durations=tuple(sorted({each.duration for each in entries})),
        payloads=tuple(sorted({each.payload for each in entries})),
        pumps=tuple(sorted({each.pump for each in entries})),
        mean_energy_j=fmean(each.energy_j or 0.0 for each in solved) if solved else None,
        mean_saving=fmean(savings) if savings else None,
        size_bytes=sum(path.stat().st_size for path in store.folder.rglob("*") if path.is_file()),
    )


def saving(entry: Entry) -> float | None:
    """Share of the pseudo-inverse's energy that a stored motion saves; None where there is none.

    Args:
        entry: The motion.
    """
    if not entry.solved or not entry.pseudo_inverse_j or entry.energy_j is None:
        return None
    return 1.0 - entry.energy_j / entry.pseudo_inverse_j


@dataclass(frozen=True, slots=True)
class Hour:
    """What an hour of work takes: every movement as often as every other, one after another without a break."""

    pump: str
    payload: float  # [kg]
    duration: float  # of a movement [s]
    movements: float  # in an hour
    energy_j: float
    pseudo_inverse_j: float | None  # the same hour with the pseudo-inverse, where that can make every movement


def hours(entries: list[Entry]) -> list[Hour]:
    """What an hour of work takes, by pump, payload and duration.

    Args:
        entries: Motions of a library.
    """
    groups: dict[tuple[str, float, float], list[Entry]] = defaultdict(list)
    for each in entries:
        if each.solved:
            groups[each.pump, each.payload, each.duration].append(each)
    found = []
    for (pump, payload, duration), group in sorted(groups.items()):
        count = HOUR / duration
        others = [each.pseudo_inverse_j for each in group if each.pseudo_inverse_j is not None]
        energy = count * fmean(each.energy_j or 0.0 for each in group)
        theirs = count * fmean(others) if len(others) == len(group) else None
        found.append(Hour(pump, payload, duration, count, energy, theirs))
    return found


def export(store: Store, out: Path) -> int:
    """Write all motions into one file: CSV with a row a stage, or Parquet with a row a motion.

    Args:
        store: The open library.
        out: The file; its ending says which.

    Returns:
        Number of motions.

    Raises:
        InputError: The file is there already, has another ending, or cannot be written.
    """
    if out.suffix not in (".csv", ".parquet"):
        raise InputError(f"out = {out}; must end with .csv or .parquet")
    if out.exists():
        raise InputError(f"out = {out}; is there already: give a new file")
    entries = store.entries("segment NOTNULL ORDER BY segment, row")
    with folders.explained(out), folders.whole(out) as new:
        (_write_csv if out.suffix == ".csv" else _write_parquet)(store, entries, new)
    return len(entries)


def _columns(entry: Entry) -> dict[str, Any]:
    """What is said of a motion beside its numbers."""
    held = asdict(entry)
    for name in ("segment", "row", "origin", "goal", "solved", "status"):
        del held[name]
    for name, place in (("from", entry.origin), ("to", entry.goal)):
        held |= {f"{name}_{axis}_m": value for axis, value in zip("xyz", place, strict=True)}
    return held


def _write_csv(store: Store, entries: list[Entry], out: Path) -> None:
    import csv

    with out.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        for number, entry in enumerate(entries):
            told, moved = _columns(entry), store.motion(entry)
            if not number:
                writer.writerow([*told, "time_s", "extension_m", "extension_m_s"])
            stages = zip(moved.breaks.tolist(), moved.position.tolist(), moved.velocity.tolist(), strict=True)
            writer.writerows([*told.values(), *stage] for stage in stages)


def _write_parquet(store: Store, entries: list[Entry], out: Path) -> None:
    from pyarrow import parquet

    pyarrow = arrow()
    rows = []
    for entry in entries:
        moved = store.motion(entry)
        numbers = {"step_s": moved.step, "position_m": moved.position.tolist(), "velocity_m_s": moved.velocity.tolist()}
        rows.append(_columns(entry) | numbers)
    parquet.write_table(pyarrow.Table.from_pylist(rows), out)

"""The page of a motion library: energies over the work area, savings, where the crane cannot go, an hour of work."""

from __future__ import annotations

from collections import Counter, defaultdict
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any

from leanboom.io import folders
from leanboom.library.overview import hours, overview, saving
from leanboom.library.store import Store
from leanboom.report import rendering
from leanboom.report.plan_page import PUMPS

if TYPE_CHECKING:
    from leanboom.library.store import Entry

PAGE = "report.html"
LISTED = 200  # movements in the table
MAPS = 12  # at most, those of the slowest motions with the least payload first

Place = tuple[float, float, float]


def write(folder: Path, unreachable: tuple[Place, ...] = ()) -> Path:
    """Write the page of a library into its folder.

    Args:
        folder: The folder.
        unreachable: Places that were asked for and are out of reach [m].

    Returns:
        The page.

    Raises:
        InputError: There is no library, or the page cannot be written.
    """
    with Store(folder) as store:
        text = page(store, unreachable)
    folders.write(folder, {PAGE: text.encode()})
    return folder / PAGE


def page(store: Store, unreachable: tuple[Place, ...] = ()) -> str:
    """The page of a library as one HTML document.

    Args:
        store: The open library.
        unreachable: Places that were asked for and are out of reach [m].
    """
    seen, entries = overview(store), store.entries()
    maps = _maps(entries)
    work = hours(entries)
    return rendering.page(
        "library",
        {"maps": maps, "unreachable": [list(place) for place in unreachable], "curves": _curves(entries)},
        task={"name": seen.name, "machine": {"name": seen.machine}},
        pump=" and ".join(PUMPS[name] for name in seen.pumps) or "no",
        solved=seen.solved == seen.motions,
        verdict=f"{seen.solved} of {seen.motions} motions solved",
        cards=[
            ("Motions", f"{seen.solved}", f"along {seen.ways} ways"),
            ("Mean energy", "-" if seen.mean_energy_j is None else f"{seen.mean_energy_j / 1e3:.1f} kJ", "of a motion"),
            ("Mean saving", "-" if seen.mean_saving is None else f"{100 * seen.mean_saving:.0f} %", "of a motion"),
            ("Size", f"{seen.size_bytes / 1e6:.1f} MB", ""),
        ],
        first_card=" first",
        saving=seen.mean_saving,
        hours=work,
        maps=[each["title"] for each in maps],
        movements=_movements(entries)[:LISTED],
        more=max(0, seen.motions - LISTED),
        reasons=Counter(each.status for each in entries if not each.solved).most_common(20),
        unreachable=unreachable,
    )


def _hub(entries: list[Entry]) -> Place | None:
    """The place that most ways begin or end at."""
    count = Counter(place for each in entries for place in (each.origin, each.goal))
    return count.most_common(1)[0][0] if count else None


def _maps(entries: list[Entry]) -> list[dict[str, Any]]:
    """Maps over the work area: one for each direction, pump, payload and duration, of the best start."""
    hub = _hub(entries)
    groups: dict[tuple, dict[Place, list[Entry]]] = defaultdict(lambda: defaultdict(list))
    for each in entries:
        out = each.origin == hub
        place = each.goal if out else each.origin
        groups[each.pump, each.payload, -each.duration, not out][place].append(each)
    found = []
    for (pump, payload, duration, back), places in sorted(groups.items())[:MAPS]:
        points = []
        for place, here in places.items():
            best = min((e for e in here if e.solved), key=lambda e: e.energy_j or 0.0, default=None)
            share = None if best is None else saving(best)
            points.append({"at": place, "energy": None if best is None else best.energy_j, "saving": share})
        way = "back" if back else "out"
        found.append({"title": f"{PUMPS[pump]}, {payload:g} kg, {-duration:g} s, {way}", "points": points})
    return found


def _curves(entries: list[Entry]) -> list[dict[str, Any]]:
    """Mean energy of all ways over duration, by pump and payload: ways with a solution for every duration."""
    groups: dict[tuple, dict[float, dict[tuple, float]]] = defaultdict(lambda: defaultdict(dict))
    for each in entries:
        if each.solved and each.energy_j is not None:
            held = groups[each.pump, each.payload][each.duration]
            way = each.origin, each.goal
            held[way] = min(held.get(way, each.energy_j), each.energy_j)
    curves = []
    for (pump, payload), by_duration in sorted(groups.items()):
        common = set.intersection(*(set(ways) for ways in by_duration.values()))
        if common:
            points = sorted((duration, fmean(ways[way] for way in common)) for duration, ways in by_duration.items())
            curves.append({"name": f"{PUMPS[pump]}, {payload:g} kg", "points": points})
    return curves


def _movements(entries: list[Entry]) -> list[dict[str, Any]]:
    """Rows of the table."""
    return [{"entry": each, "saving": saving(each)} for each in entries]

"""Checks between the values of a file: linkages that close over their joint's range, strokes, counts, kinds.

Every check looks at the sections that are right in themselves, so that one bad value does not hide another.
"""

from __future__ import annotations

from functools import cache
from math import pi
from typing import Annotated, Any

from pydantic import TypeAdapter, ValidationError

from leanboom.components.cylinders import Connection
from leanboom.components.linkages import Linkage, Telescope
from leanboom.components.paths import PATHS
from leanboom.components.pumps import EfficiencyMap, Pump
from leanboom.io.schema import AREAS, SIZE_KEYS, BodyKeys, CylinderKeys, TaskKeys
from leanboom.io.yaml_source import Data, Key, Source
from leanboom.model.legs import Leg
from leanboom.model.legs import faults as leg_faults
from leanboom.model.machine import JOINTS, AngleRange, LengthRange, Machine
from leanboom.model.pump_flow import base_fault
from leanboom.model.task import TIMINGS, End, Lasting, Limits, Start, faults, paths
from leanboom.quantities.declarations import Section, Variant, declared
from leanboom.quantities.types import Cutoff, Duration, Price
from leanboom.quantities.units import is_bare

_CYLINDER = Annotated[Any, Section(CylinderKeys)]
_BODY = Annotated[Any, Section(BodyKeys)]
_PUMP = Annotated[Any, Section(Pump, stated=True)]
_SAMPLES = 2001  # of a joint's range
_SMALLEST_ARM = 1e-4  # [m]
SIZES = "must be given as bore and rod, as plunger (and racks), or as piston_area and rod_side_area"


def size(keys: Any) -> dict[str, float]:
    """The keys of a cylinder's section that give its size."""
    return {name: value for name in SIZE_KEYS if (value := getattr(keys, name)) is not None}


def areas(given: dict[str, float]) -> tuple[float, float] | None:
    """Piston-side and rod-side area [m^2]; None if the size is not given in one of the three ways."""
    if given.keys() == {"bore", "rod"}:
        return pi / 4 * given["bore"] ** 2, pi / 4 * (given["bore"] ** 2 - given["rod"] ** 2)
    if "plunger" in given and given.keys() <= {"plunger", "racks"}:
        area = pi / 4 * given["plunger"] ** 2 * given.get("racks", 1)
        return area, area
    if given.keys() == set(AREAS):
        return given["piston_area"], given["rod_side_area"]
    return None


def stroke(shape: Linkage, lower: float, upper: float) -> float:
    """The change of a cylinder's length [m] over its joint's range, from end to end [rad or m]."""
    return abs(float(shape.length_arm_slope(upper)[0]) - float(shape.length_arm_slope(lower)[0]))


def check_machine(source: Source) -> None:
    """Note the contradictions in a machine file."""
    data = source.data
    if not isinstance(data, dict):
        return
    _check_slewing(source, data)
    joints, cylinders = _mapping(data, "joints"), _mapping(data, "cylinders")
    for name in JOINTS:
        keys = _part(_CYLINDER, cylinders.get(name))
        if keys is None:
            continue
        key = ("cylinders", name)
        sized = _check_size(source, key, keys)
        if sized and keys.friction.steps is not None and name != "extension":
            source.refuse((*key, "friction", "steps"), "only the extension cylinder may have steps")
        telescope = isinstance(keys.linkage, Telescope)
        if telescope != (name == "extension"):
            allowed = "must be telescope" if name == "extension" else "must not be telescope on a rotating joint"
            source.refuse((*key, "linkage", "type"), f"{allowed}")
            continue
        joint = _part(LengthRange if name == "extension" else AngleRange, joints.get(name))
        if joint is not None:
            _check_linkage(source, key, keys, joint)
    for name, body in _mapping(data, "bodies").items():
        keys = _part(_BODY, body)
        if keys is not None and keys.extension_share and keys.carrier != "tilt":
            source.refuse(("bodies", name, "extension_share"), "must be 0 unless the carrier is tilt")
    pump = _part(_PUMP, data.get("pump"))
    if pump is not None:
        for name in ("constant_pressure", "ls_margin"):
            if getattr(pump, name) > pump.max_pressure:
                limit = str(source.value(("pump", "max_pressure")))
                limit += " Pa" if is_bare(limit) else ""
                source.refuse(("pump", name), f"must be at most max_pressure = {limit}")
        if isinstance(pump.efficiency, EfficiencyMap):
            _check_map(source, pump.efficiency, pump.max_flow)


def _mapping(data: dict[str, Data], name: str) -> dict[str, Data]:
    part = data.get(name)
    return part if isinstance(part, dict) else {}


def _part(kind: Any, data: Data) -> Any:
    """A part of a file on its own; None if it is missing or anything in it is wrong.

    Args:
        kind: Its type, with its rule.
        data: As in the file.
    """
    try:
        return None if data is None else _reader(kind).validate_python(data)
    except ValidationError:
        return None


@cache
def _reader(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def _check_slewing(source: Source, data: dict[str, Data]) -> None:
    slewing = _mapping(data, "geometry").get("slewing")
    for section in ("joints", "cylinders"):
        part = _mapping(data, section)
        if slewing is True and part and part.get("base") is None:
            source.add((section, "base"), " is missing", "must be given since geometry.slewing = true")
        if slewing is False and "base" in part:
            source.add((section, "base"), " is given", "must be left out since geometry.slewing = false")


def _check_size(source: Source, key: Key, keys: Any) -> bool:
    """Whether a cylinder's areas are right; problems are noted."""
    found = areas(size(keys))
    if found is None:
        given = [f"{name} = {source.value((*key, name))}" for name in size(keys)]
        source.add(key, f" has {', '.join(given) or 'no size'}", f"its size {SIZES}")
        return False
    if found[1] <= 0.0:
        source.refuse((*key, "rod"), f"must be below bore = {source.value((*key, 'bore'))}")
    elif found[1] > found[0]:
        limit = source.value((*key, "piston_area"))
        source.refuse((*key, "rod_side_area"), f"must be at most piston_area = {limit}")
    elif keys.connection is Connection.DIFFERENTIAL and found[1] >= found[0]:
        source.refuse((*key, "connection"), "must be standard or single_acting, since both areas are equal")
    return True


def _check_map(source: Source, given: EfficiencyMap, max_flow: float) -> None:
    """Note a map of the wrong shape, a speed or flow beyond it, and a map that no shaft power meets."""
    from leanboom.components.pump_power import ALLOWED, at_speed, fit

    key = ("pump", "efficiency")
    axes = [("speeds", (*key, "total"), given.total)]
    axes += [("displacements", (*key, "total", i), table) for i, table in enumerate(given.total)]
    for i, table in enumerate(given.total):
        axes += [("pressures", (*key, "total", i, j), row) for j, row in enumerate(table)]
    wrong = [(name, where, entries) for name, where, entries in axes if len(entries) != len(getattr(given, name))]
    for name, where, entries in wrong:
        count = len(getattr(given, name))
        source.add(where, f" has {len(entries)} entries", f"must have {count}, one for each of {name}")
    if not given.speeds[0] <= given.speed <= given.speeds[-1]:
        ends = [source.value((*key, "speeds", i)) for i in (0, len(given.speeds) - 1)]
        source.refuse((*key, "speed"), f"must be from {ends[0]} to {ends[1]}, the ends of speeds")
        return
    most = given.speed * given.displacements[-1]
    if max_flow > most * (1.0 + 1e-9):
        flow = f"{most * 6e4:.6g} l/min, speed times the last of efficiency.displacements"
        source.refuse(("pump", "max_flow"), f"must be at most {flow}")
    if wrong:
        return
    met = fit(given)
    if met.typical > ALLOWED:
        i, j = met.worst
        point = [source.value((*key, *where)) for where in (("speed",), ("displacements", i), ("pressures", j))]
        place = ", ".join(map(str, point))
        source.add(
            (*key, "total"),
            f" is no map of a pump: losses that rise with pressure and flow meet its powers within "
            f"{100.0 * met.typical:.1f} %",
            f"must be within {100.0 * ALLOWED:g} %; "
            f"farthest off, by {100.0 * met.largest:.0f} %, is {at_speed(given)[i, j]:.4g} at {place}",
        )


def _check_linkage(source: Source, key: Key, keys: Any, joint: tuple[float, float]) -> None:
    """Note a linkage that cannot close or has no torque arm somewhere in its joint's range, or a wrong stroke."""
    import numpy as np

    shape = keys.linkage
    q = np.linspace(*joint, _SAMPLES)
    name = key[-1]
    kind = source.value((*key, "linkage", "type"))
    unit = "m" if name == "extension" else "rad"
    span = f"joints.{name} = [{joint[0]:.6g}, {joint[1]:.6g}] {unit}"
    with np.errstate(all="ignore"):
        open_at = q[~shape.closes(q)]
        _, arm, _ = shape.length_arm_slope(q)
        dead = q[~(arm * arm[0] > _SMALLEST_ARM * abs(arm[0]))]
    where = (*key, "linkage")
    if open_at.size:
        source.add(where, f" = {kind}", f"must close over {span}, but does not at {open_at[0]:.3f} {unit}")
    elif dead.size:
        place = f"{dead[0]:.3f} {unit}"
        source.add(where, f" = {kind}", f"must have a torque arm over {span}, but passes a dead centre at {place}")
    elif keys.stroke is not None:
        change = stroke(shape, *joint)
        if abs(change - keys.stroke) > max(1e-3, 0.02 * keys.stroke):
            source.refuse(
                (*key, "stroke"),
                f"must be {change:.4f} m within 2 %, the change of the cylinder's length over {span}, or be left out",
            )


def check_task(source: Source, machine: Machine | None) -> None:
    """Note the contradictions in a task file, or between the task and its machine."""
    data = source.data if isinstance(source.data, dict) else {}
    for key in ("path", "payload", "timing", "duration"):
        if "legs" in data and key in data:
            source.refuse((key,), "must be left out, since each of the legs has its own")
        elif "legs" not in data and key not in data and key in ("path", "payload"):
            source.add((key,), " is missing", declared(TaskKeys)[key].rule.allowed)
    given = data.get("legs")
    legs = [_part(Annotated[Any, Section(Leg)], leg) for leg in given] if isinstance(given, list) else []
    times = (_part(kind, data.get(key)) for kind, key in ((Duration, "total"), (Price, "time_price")))
    for key, _, what in leg_faults(legs, *times):
        source.refuse(key, what)
    if machine is None:
        return
    made = _part(Annotated[Any, Variant(PATHS)], data.get("path"))
    start, end, smooth = (
        _part(kind, data.get(key)) for kind, key in ((Start, "start"), (End, "end"), (Cutoff, "smooth"))
    )
    timing, duration = data.get("timing", "fixed"), data.get("duration")
    if duration is not None and timing == "shortest":
        source.refuse(("duration",), "must be left out with timing: shortest, which plans it")
    elif duration == "shortest" and timing == "free":
        source.refuse(("timing",), "must be left out with duration: shortest, which plans the speed as well")
    elif duration == "shortest":
        timing = duration
    timing = timing if timing in TIMINGS else "fixed"
    found = faults(
        paths(made, legs), machine, "middle" if start is None else start, "free" if end is None else end, smooth, timing
    )
    for key, _, what in found:
        source.refuse(key, what)
    limits = _part(Annotated[Limits, Section(Limits)], data.get("limits"))
    if limits is None or not limits.pump_flow or found:
        return
    if made is not None and timing == "fixed":
        lasting = _part(Lasting, duration)
        what = base_fault(machine, made if lasting is None else made.slower(lasting / made.duration))
        if what:
            source.refuse(("limits", "pump_flow"), what)
    for i, leg in enumerate(legs):
        if leg is not None and leg.settled and (what := base_fault(machine, leg.timed)):
            source.refuse(("limits", "pump_flow"), f"{what} (leg {i + 1})")

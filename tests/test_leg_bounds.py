"""Bounds of work cycles: legs as one chain of stages, closed or not, never exceed what any of their motions takes."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import slow_bounds
from leanboom import load_task
from leanboom.certificate import lower_bounds, partition, upper_bound, value_slopes
from leanboom.model import motion
from leanboom.model.task import Leg, Limits, Lines, Task
from leanboom.problem import least_flow, stages
from leanboom.problem.legs import Legs, alone
from slow_bounds import quiet

STAGES = 3  # of a leg


def small_cycle(seed: int, closed: bool) -> Task:
    """There and back with a load: legs of about a second, on the loader or the forwarder."""
    rng = np.random.default_rng(seed)
    machine = load_task("forwarder-vertical" if seed % 2 else "loader-triangle-small").machine
    first = np.array([5.0, 0.0, 2.5]) if seed % 2 else np.array([2.2, 0.0, 1.2])
    second = first + np.array([rng.uniform(-0.15, 0.15), 0.0, rng.uniform(-0.15, 0.15)])
    ends = tuple(first.tolist()), tuple(second.tolist())
    times = rng.uniform(0.8, 1.5, 2).tolist()
    legs = (
        Leg(payload=0.0, path=Lines(ends, times[:1])),
        Leg(payload=150.0, path=Lines(ends[::-1], times[1:]), dwell=0.5),
    )
    return Task("cycle", machine, legs=legs, start="best" if closed else "middle", end="same" if closed else "free")


def cut(task: Task) -> Legs:
    """Its legs in a few stages."""
    return Legs(tuple(stages.discretise(each, each.duration / STAGES) for each in alone(task)))


def limited(task: Task) -> Task:
    """A task whose pump gives little more than its legs ask for at least."""
    most = 1.6 * max(float(least_flow.least_flow(each).max()) for each in cut(task).problems)
    machine = replace(task.machine, pump=replace(task.machine.pump, max_flow=most))
    return replace(task, machine=machine, limits=Limits(pump_flow=True))


@pytest.mark.parametrize(
    ("seed", "pump", "closed", "flow"),
    [
        (1, "cp", True, False),
        (2, "ls", True, False),
        (3, "cp", True, True),
        (2, "cp", False, False),
        (1, "ls", False, True),
    ],
)
def test_the_bound_of_legs_never_exceeds_the_brute_force_optimum(seed, pump, closed, flow, rng, monkeypatch):
    monkeypatch.setattr(value_slopes, "GRID", (61, 31))
    monkeypatch.setattr(value_slopes, "TUBE", (31, 31))
    task = small_cycle(seed, closed)
    legs = cut(limited(task) if flow else task)
    start = None if closed else 0.5 * float(legs.lower[0] + legs.upper[0])
    least, best = slow_bounds.least_of_legs(legs, pump, start, closed, 7)
    assert best is not None
    multiplier, lower, level = None, 0.0, 0
    if closed:  # any will do to begin with; those that bounds suggest are good ones
        at = np.sort(rng.uniform(legs.lower[0] - 0.1, legs.upper[0] + 0.1, 12))
        multiplier = np.stack([at, -rng.uniform(0.0, 0.2 * least, at.size)])
    kept, limit = partition.whole(legs, pump, best.motion, (2, 2)), least * (1.0 + 1e-9)
    while kept is not None and level < 3:
        guide = value_slopes.make(legs, pump, kept.viable, best.motion, None, multiplier) if level == 1 else None
        bounds = lower_bounds.bound(
            kept, start, quiet, guide and guide.slopes, limit if level else np.inf, level == 0, multiplier=multiplier
        )
        assert bounds.lower <= limit
        assert lower_bounds.residuals(bounds, best.motion, best.costs).min() >= -1e-9 * least
        if multiplier is not None:
            before, multiplier = multiplier, lower_bounds.steeper(bounds, multiplier)
            everywhere = np.union1d(before[0], multiplier[0])
            assert np.all(np.interp(everywhere, *multiplier) <= np.interp(everywhere, *before) + 1e-9)
        lower, level = max(lower, bounds.lower), level + 1
        kept = lower_bounds.refine(bounds, lower_bounds.reach(bounds, limit, quiet)) if level < 3 else None
    assert lower >= 0.8 * least  # close enough to mean something


@pytest.mark.parametrize("seed", [3, 5])
def test_legs_hand_on_what_the_next_ones_take_and_a_cycle_closes(seed):
    """A cycle was once bounded by the sum of its legs, each from and to any extension."""
    legs = cut(small_cycle(seed, True))
    least, best = slow_bounds.least_of_legs(legs, "cp", None, True, 7)
    assert best is not None

    def bounds(some: Legs, beside: motion.Motion, multiplier: np.ndarray | None = None) -> lower_bounds.Bounds:
        kept = partition.whole(some, "cp", beside, (4, 4))
        return lower_bounds.bound(kept, None, quiet, coarse=True, multiplier=multiplier)

    ends = np.cumsum([0.0, *(each.time[-1] for each in legs.problems)])
    parts = [motion.between(best.motion, *span) for span in pairwise(ends.tolist())]
    apart = sum(bounds(Legs((each,)), part).lower for each, part in zip(legs.problems, parts, strict=True))
    none = np.array([[legs.lower[0], legs.upper[0]], [0.0, 0.0]])
    found = bounds(legs, best.motion, none)
    joined, free = found.lower, bounds(legs, best.motion).lower
    closed = bounds(legs, best.motion, lower_bounds.steeper(found, none)).lower
    assert apart < free == joined < closed - 0.003 * least < closed <= least


def test_a_stage_between_legs_is_one_stage():
    task = small_cycle(1, True)
    legs = cut(task)
    assert legs.stages == 2 * STAGES and legs.firsts.tolist() == [0, STAGES, 2 * STAGES]
    assert [legs.of_stage(k) for k in (0, STAGES - 1, STAGES, 2 * STAGES)] == [(0, 0), (0, 2), (1, 0), (1, STAGES)]
    assert legs.lower[STAGES] == legs.problems[1].lower[0]
    kept = partition.whole(legs, "ls", None, (2, 2))
    assert kept.setting[0, 0] == legs.problems[0].step and kept.setting[STAGES, 0] == legs.problems[1].step
    for k in (0, STAGES, 2 * STAGES):  # legs begin and end at rest
        assert np.abs(kept.columns[k]).max() <= partition.REST
    joined = upper_bound.joined(
        [
            upper_bound.measure(each, stages.on_stages(each, motion.held(0.5, each.time[-1], "held", "ls")), "ls")
            for each in legs.problems
        ]
    )
    assert joined.motion.position.size == legs.stages + 1 == joined.costs.size + 1

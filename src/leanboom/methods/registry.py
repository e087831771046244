"""The methods that plan a task, by name, and the contract that they keep.

A method of one's own is a function with the arguments of `PlanFunction`, described as a `Method`. A program adds it by
`METHODS.add(name, method)`; an installed package brings it by an entry point of the group `leanboom.methods`.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from leanboom.extensions import Registry

if TYPE_CHECKING:
    from leanboom.evaluation.evaluate import Evaluation
    from leanboom.model.motion import Motion
    from leanboom.model.task import Task
    from leanboom.progress import Progress

GRID = (121, 61)  # positions and velocities of the coarse program: coarser ones miss local minima of random tasks
STEP = 0.05  # length of a stage [s]


@dataclass(frozen=True, slots=True)
class Effort:
    """How far the search goes."""

    minima: int  # local minima followed at most
    stages: int  # of all of them together, about: the shorter the task, the more are followed
    share: float  # how much more than the best they may cost on the coarse grid
    leading: int  # of them, refined further at most
    shortest: int  # stages are at most this many times shorter at the end
    grids: tuple[float, ...] = (1.0,)  # coarse grids that show local minima, in nodes of the one asked for

    def most(self, count: int, loads: bool) -> int:
        """Local minima to follow on a number of stages; without loads there are few."""
        return min(self.minima, max(2, self.stages // count) if loads else 2)


EFFORTS = {
    "quick": Effort(1, 0, 0.0, 1, 1),
    "default": Effort(4, 800, 0.02, 2, 4),
    "thorough": Effort(24, 4800, 0.05, 4, 4, (1.0, 1.7)),
}


@dataclass(frozen=True, slots=True)
class Settings:
    """What is asked of a method besides task and cost; it uses what it has a use for."""

    grid: tuple[int, int] = GRID  # position and velocity nodes of a coarse grid
    step: float = STEP  # length of a stage [s]
    effort: str = "default"  # a name of `EFFORTS`
    seeds: tuple[Motion, ...] = ()  # known motions: the answer is no worse than a feasible one of them
    # Makes one more seed of a feasible motion, or None: a proof of how good that is finds other motions.
    prover: Callable[[Motion], Motion | None] | None = None


# Task, cost, start of the redundant cylinder [m], progress, settings -> motion, or its evaluation where there is one.
# The start is None for a method with `free_start`. A motion that is no result has a status of `Kind.UNCONVERGED`.
PlanFunction = Callable[["Task", str, float | None, "Progress", Settings], "Motion | Evaluation"]


@dataclass(frozen=True, slots=True)
class Method:
    """A way to plan a task."""

    sentence: str  # how it plans
    function: PlanFunction | str  # a text, "module:name", is imported when it is used
    costs: tuple[str, ...] | None = None  # costs that it can minimise; None: all of `costs.COSTS`
    compared: tuple[str, ...] | None = None  # costs that comparisons minimise; None: those of the pumps looked at
    pointwise: bool = False  # minimises its one cost at every instant, whatever is asked for
    free_start: bool = False  # finds the start by itself, and a task may ask for the best one
    ends: bool = False  # leads the redundant cylinder to the end that a task asks for
    flow: bool = True  # takes tasks that limit the pump's flow: keeps to it, or leaves it to the judge
    timing: bool = False  # plans on any timing of a path from a given motion: a task may leave its timing to be planned
    exhaustive: bool = False  # looks at all feasible extensions: where it fails, a proof is worth looking for
    slow: bool = False  # takes minutes; compared on request alone
    weight: float = 1.0  # how long it takes, roughly, beside others: the longest go first
    prepare: Callable[[], None] | str | None = None  # compiles kernels before time is taken; a text as above

    def plan(self, task: Task, cost: str, start: float | None, tell: Progress, settings: Settings) -> Any:
        """What the method's function answers; arguments as in `PlanFunction`."""
        return _imported(self.function)(task, cost, start, tell, settings)

    def minimises(self, cost: str) -> bool:
        """Whether a cost can be asked for; one that is pointwise takes no notice."""
        return self.pointwise or self.costs is None or cost in self.costs

    def warm_up(self) -> None:
        """Compile, or load, what the method needs."""
        if self.prepare is not None:
            _imported(self.prepare)()


def _imported(thing: Any) -> Any:
    return pkgutil.resolve_name(thing) if isinstance(thing, str) else thing


_SMOOTH = ("ls", "cp")  # costs that are stated smoothly
_KERNELS = "leanboom.fixed_mode.modes:prepare"

METHODS: Registry[Method] = Registry(
    "method",
    "leanboom.methods",
    {
        "dp": Method(
            "dynamic programming over all extensions, refined in tubes and polished",
            "leanboom.methods.dp_refined:plan",
            compared=("ls", "cp", "actuator", "velocity", "extension"),
            free_start=True, ends=True, timing=True, exhaustive=True, weight=6.0, prepare=_KERNELS,
        ),
        "polish": Method(
            "nonlinear programming alone: the polish started from the pseudo-inverse",
            "leanboom.methods.dp_refined:plan_by_polish",
            free_start=True, ends=True, prepare=_KERNELS,
        ),
        "pseudospectral": Method(
            "Legendre-Gauss-Radau collocation of the smoothed problem, bootstrapped",
            "leanboom.methods.pseudospectral:plan",
            costs=_SMOOTH, compared=_SMOOTH, flow=False, weight=30.0,
        ),
        "shooting": Method(
            "direct multiple shooting in all joints",
            "leanboom.methods.multiple_shooting:plan",
            costs=_SMOOTH, compared=_SMOOTH, flow=False, weight=60.0,
        ),
        "dp1": Method(
            "one-state dynamic programming, velocity as control (3-DOF paper)", "leanboom.methods.dp_velocity:plan"
        ),
        "dp-paper": Method(
            "Algorithm 1 of the 4-DOF paper to the letter", "leanboom.methods.dp_paper:plan", slow=True, weight=600.0
        ),
        "sns-joint": Method(
            "joint-limited pseudo-inverse, least joint velocities",
            "leanboom.methods.pseudo_inverse:plan",
            costs=("joint-velocity",), compared=("joint-velocity",), pointwise=True,
        ),
        "sns-actuator": Method(
            "actuator-limited pseudo-inverse, least cylinder velocities",
            "leanboom.methods.pseudo_inverse:plan",
            costs=("velocity",), compared=("velocity",), pointwise=True,
        ),
        "sns-actuator-weighted": Method(
            "the same, cylinder velocities weighted by flow areas",
            "leanboom.methods.pseudo_inverse:plan",
            costs=("weighted-velocity",), compared=("weighted-velocity",), pointwise=True,
        ),
    },
    lambda item: isinstance(item, Method),
    "a leanboom.methods.registry.Method",
)  # fmt: skip

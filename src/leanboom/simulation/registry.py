"""The controllers of the closed loop, by name.

A program adds one of its own by `CONTROLLERS.add(name, factory)`; an installed package brings it by an entry point of
the group `leanboom.controllers`. What a controller is, `controllers` says.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from leanboom.extensions import Registry

if TYPE_CHECKING:
    from leanboom.simulation.controllers import Factory

CONTROLLERS: Registry[Factory] = Registry(
    "controller",
    "leanboom.controllers",
    {
        "dead-zone-inverse": "leanboom.simulation.controllers:DeadZoneInverse",
        "adaptive-robust": "leanboom.simulation.adaptive_robust:AdaptiveRobust",
    },
    callable,
    "a class or a function that makes a controller of a Rig",
)

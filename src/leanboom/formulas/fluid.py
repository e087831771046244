"""Compressible chambers and throttling edges. Eqs. (18)-(19), (21)-(22) and (25)-(26), 4-DOF paper.

| symbol | name | unit |
| --- | --- | --- |
| p, V | pressure and volume of a chamber | Pa, m^3 |
| B | effective bulk modulus B_eff | Pa |
| Q | flow into the chamber | m^3/s |
| K | flow coefficient K_v of an edge | m^3/(s sqrt(Pa)) |
| x, v | piston position beyond retracted, piston velocity | m, m/s |

All functions are formulas: numbers, arrays or CasADi symbols in, the same out.
"""

from __future__ import annotations

import numpy as np

from leanboom.formulas.formula import formula

LAMINAR = 1e4  # [Pa], below this drop an edge's flow is linear in it instead of turbulent
CONTACT = 0.2  # [s/m], damping of a cylinder's end per approach velocity, Hunt and Crossley (1975)


@formula
def orifice(drop, K):
    """Flow of an edge at a pressure drop [m^3/s]: K sqrt(drop), linear where the drop is small, none backwards."""
    drop = np.maximum(drop, 0.0)
    return K * drop / np.sqrt(np.sqrt(drop * drop + LAMINAR * LAMINAR))


@formula
def compensated(available, drop, K):
    """Flow of an edge whose compensator holds a drop as long as so much is available [m^3/s]. Eqs. (21)-(22)."""
    return orifice(np.minimum(available, drop), K)


@formula
def pressure_rate(flow, displacement, volume, B):
    """Rate of a chamber's pressure [Pa/s] for net flow in and swept volume [m^3/s]. Eqs. (18)-(19)."""
    return B / volume * (flow - displacement)


@formula
def chamber_volume(dead, area, length):
    """Volume of a chamber [m^3] whose piston is a length from its end; no less than the dead volume."""
    return dead + area * np.maximum(length, 0.0)


@formula
def end_force(x, v, stroke, stiffness):
    """Force of the cylinder's ends on its piston [N]: springs that only push, damped by the approach."""
    low = np.maximum(-x, 0.0)
    high = np.maximum(x - stroke, 0.0)
    push = stiffness * low * np.maximum(1.0 - v / CONTACT, 0.0)
    return push - stiffness * high * np.maximum(1.0 + v / CONTACT, 0.0)


@formula
def opening(travel, dead_zone):
    """Share of a spool edge that is open at a travel from 0 to 1: nothing in the dead zone, then progressive."""
    share = np.minimum(np.maximum((travel - dead_zone) / (1.0 - dead_zone), 0.0), 1.0)
    return 0.5 * share * (1.0 + share)


@formula
def gate(share):
    """Share to which an edge's opening connects the load-sensing line: 0 closed, 1 from a hundredth on."""
    return np.minimum(100.0 * share, 1.0)


@formula
def supply_rate(wanted, pressure, time_constant, free_flow, stiffness):
    """Rate of the supply pressure [Pa/s]: first order, and no faster than the pump's free flow fills the line.

    `free_flow` is the largest flow less what the valves take [m^3/s], `stiffness` B over the line's volume.
    """
    return np.minimum((wanted - pressure) / time_constant, stiffness * free_flow)

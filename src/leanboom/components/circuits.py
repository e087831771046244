"""The hydraulics around the valves in the closed-loop simulation."""

from __future__ import annotations

from dataclasses import dataclass

from leanboom.quantities.declarations import hold_declared
from leanboom.quantities.types import (
    DeadZone,
    Delay,
    Flow,
    Frequency,
    LeastFrequency,
    LeastLength,
    PositivePressure,
    Pressure,
    PumpTime,
    Share,
    Volume,
)


@dataclass(frozen=True, slots=True)
class Circuit:
    """The hydraulics of the closed-loop simulation; values not given are the defaults of the kind of valve."""

    # The defaults are those of a mobile valve; `valves.METERING` are those of independent metering.
    bulk_modulus: PositivePressure = 1e9  # B_eff of eqs. (18)-(19)
    """Effective, of oil and hoses."""
    dead_volume: Volume = 1e-3  # V_0A, V_0B
    """Chamber and hose with the piston at its end."""
    line_volume: Volume = 3e-3
    """Between pump and valves."""
    pump_time_constant: PumpTime = 0.2
    """Of the supply pressure."""
    edge_flow: Flow = 170e-3 / 60
    """Flow of a fully open valve edge at its compensated pressure drop."""
    edge_drop: PositivePressure = 0.7e6
    """That drop; a mobile valve's compensator_drop counts instead."""
    spool_bandwidth: Frequency = 8.0  # where the amplitude has fallen by 3 dB
    """Of the spool behind its command."""
    delay: Delay = 0.16
    """From a command to the spool's first movement; at least one sample of 2 ms."""
    dead_zone: DeadZone = 0.53
    """Share of the spool's travel that opens nothing."""
    counter_pressure: Pressure = 0.3e6
    """Of the return line above the tank."""
    seal_friction: Share = 0.0
    """Coulomb friction beside planning's, as a share of the cylinder's force at constant pressure."""
    seal_damping: Share = 0.0
    """Viscous friction at the velocity limit beside planning's, as a share of the same force."""
    # What real cranes have besides; 0 leaves each out.
    delay_slack: Delay = 0.0
    """Further delay where the supply has no pressure, in proportion to what it lacks of the pump's highest; 0: none."""
    hysteresis: Share = 0.0
    """Play of the spool behind its command, as a share of its travel; 0: none."""
    sensing_time: Delay = 0.0
    """Time constant of the load pressure on its way to a load-sensing pump; 0: it arrives at once."""
    tip_frequency: LeastFrequency = 0.0
    """Of the tool's mass on the bending telescope; 0: it does not bend."""
    tip_damping: Share = 0.05
    """Damping ratio of that bending."""
    hanging_length: LeastLength = 0.0
    """From the tool to the centre of the load that hangs and swings there; 0: it does not swing."""
    hanging_damping: Share = 0.05
    """Damping ratio of that swing."""

    def __post_init__(self) -> None:
        hold_declared(self, "simulation")

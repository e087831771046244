"""Where each quantity stands in the arrays that kernels take."""

from __future__ import annotations

# Columns of a node's coefficient table, (stages + 1, positions, moving cylinders, COEFFICIENTS).
A0, A1, B0, B1, B2, B3, F0, F1, F2, F3, COULOMB = range(11)
COEFFICIENTS = 11
# Columns of the stage table, (stages + 1, STAGE_COLUMNS). All stages share one spacing of velocities, DW.
C_LO, DC, W_LO, DW, FIXED_FLOW, FIXED_PRESSURE, FIXED_COST = range(7)
STAGE_COLUMNS = 7
# Columns of the cylinder table, (moving cylinders, CYLINDER_COLUMNS); areas and SQUARE are those of the cost's terms.
AREA_OUT, AREA_IN, GAIN_OUT, BACK_OUT, GAIN_IN, BACK_IN, SHARPNESS, VISCOUS, V_MAX, A_MAX, SQUARE = range(11)
CYLINDER_COLUMNS = 11
# Entries of the setting vector. SENSING: 1 where the highest pressure demanded adds to SUPPLY; WORK: 1 where it counts.
STEP, SENSING, WORK, EPSILON, SUPPLY, EFFICIENCY, SLOPE_C, SLOPE_W, SLOPE_V, SLOPE_A, IDLE, LEAK, DRAG = range(13)
SETTINGS = 13

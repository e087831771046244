"""Where each quantity stands in the arrays that kernels take."""

from __future__ import annotations

# Columns of a node's coefficient table, (stages + 1, positions, moving cylinders, COEFFICIENTS).
A0, A1, B0, B1, B2, B3, F0, F1, F2, F3, COULOMB = range(11)
COEFFICIENTS = 11
# Columns of the stage table, (stages + 1, STAGE_COLUMNS). All stages share one spacing of velocities, DW.
# MOST_FLOW is what the pump gives at most less what the path alone takes.
C_LO, DC, W_LO, DW, FIXED_FLOW, FIXED_PRESSURE, FIXED_COST, MOST_FLOW = range(8)
STAGE_COLUMNS = 8
# Columns of the cylinder table, (moving cylinders, CYLINDER_COLUMNS); areas and SQUARE are those of the cost's terms,
# FLOW_OUT and FLOW_IN the areas through which a cylinder takes oil from the pump, whatever the cost.
AREA_OUT, AREA_IN, GAIN_OUT, BACK_OUT, GAIN_IN, BACK_IN, SHARPNESS, VISCOUS, V_MAX, A_MAX, SQUARE = range(11)
FLOW_OUT, FLOW_IN = range(11, 13)
CYLINDER_COLUMNS = 13
# Entries of the setting vector. SENSING: 1 where the highest pressure demanded adds to SUPPLY; WORK: 1 where it counts;
# SLOPE_F: 0 where the pump's flow is no limit.
STEP, SENSING, WORK, EPSILON, SUPPLY, EFFICIENCY, SLOPE_C, SLOPE_W, SLOPE_V, SLOPE_A, IDLE, LEAK, DRAG = range(13)
SLOPE_F = 13
SETTINGS = 14

"""The models: a machine, its crane of formulas, a task in time, a motion of the redundant cylinder."""

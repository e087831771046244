"""The closed loop: bodies, oil, valves, pump and controller following a plan."""

"""Parts a crane is made of, and the costs of its motion: linkages, valves, pump, friction, paths and costs."""

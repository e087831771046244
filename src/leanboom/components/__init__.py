"""Parts a crane is made of, and what is asked of it: linkages, valves, pump, friction, paths and costs."""

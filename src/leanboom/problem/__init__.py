"""The discretised problem: stages, feasible strokes, and all physics as arrays that kernels take."""

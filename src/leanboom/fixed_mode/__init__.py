"""Fixed-mode nonlinear program: directions and load signs fixed, solved by an interior-point method."""

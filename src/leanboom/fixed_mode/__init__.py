"""Fixed-mode nonlinear program: directions and load signs held, solved by an interior-point method."""

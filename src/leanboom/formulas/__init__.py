"""Pure formulas: numbers, arrays, CasADi symbols or compiled kernels in, the same out."""

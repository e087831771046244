"""A plant advanced in time by VODE, the stiff solver of SciPy: variable order, variable step, no restarts.

Valve edges are known functions of time for as long as the valves' delay ahead, linear between samples. The solver's
steps are no longer than that, so it may run past a sample and interpolate back, keep its history, and still never
see an input that changes afterwards. Brown, Byrne, Hindmarsh, SIAM J. Sci. Stat. Comput. 10 (1989) 1038.
"""

from __future__ import annotations

import warnings

import numpy as np

from leanboom.errors import LeanboomError
from leanboom.simulation.plant import Plant, bind

TOLERANCE = 1e-6  # relative, of all states
LONGEST = 10  # samples of a step, at most
# Absolute tolerances at TOLERANCE: joints, their velocities, pressures [Pa], energies [J], those of the tip likewise.
ABSOLUTE = (1e-7, 1e-6, 2e2, 1e-2, 1e-7, 1e-6, 2e2)


class SolverError(LeanboomError):
    """Error of a solver that makes no progress."""


class Integrator:
    """A plant's state moving from sample to sample.

    Args:
        plant: The plant.
        start: State to begin with, (size,).
        edges: Open shares of the valve edges at every sample, (samples, cylinders x 4); filled by the caller, at
            least `ahead` samples before `advance` comes to them.
        load_sensing: Whether the pump is a load-sensing one.
        step: Time between samples [s].
        ahead: How many samples ahead edges are known.
        tolerance: Relative tolerance.
        since: Sample to begin at.
    """

    def __init__(
        self, plant: Plant, start: np.ndarray, edges: np.ndarray, *, load_sensing: bool, step: float, ahead: int,
        tolerance: float = TOLERANCE, since: int = 0,
    ):  # fmt: skip
        from scipy.integrate import ode

        layout = plant.layout
        self.state = np.array(start, dtype=np.float64)
        self._edges, self._step = edges, step
        self._y, self._u = np.zeros(layout.size), np.zeros(edges.shape[1] + 1)
        self._u[-1] = 1.0 if load_sensing else 0.0
        self._shares = self._u[:-1]
        self._rates = np.zeros(layout.size)
        self._moved = np.zeros(2 * layout.n)
        self._eval_rates = bind(plant.rates, (self._y, self._u), (self._rates,))
        self._eval_measure = bind(plant.measure, (self._y,), (self._moved,))
        absolute = np.empty(layout.size)
        pressures = slice(layout.a.start, layout.supply + 1)
        parts = layout.q, layout.v, pressures, layout.energy, layout.bent, layout.bending, layout.sense
        for part, value in zip(parts, ABSOLUTE, strict=True):
            absolute[part] = value * tolerance / TOLERANCE
        # The solver takes its Jacobian by differences: an exact one misleads it at the model's kinks, as measured in
        # docs/simulation.md, and some releases of SciPy read a given one transposed.
        self._solver = ode(self._right)
        self._solver.set_integrator(
            "vode", method="bdf", with_jacobian=True, rtol=tolerance, atol=absolute, order=5, nsteps=20000,
            max_step=min(max(ahead, 1), LONGEST) * step,
        )  # fmt: skip
        self._solver.set_initial_value(self.state, since * step)

    def _right(self, time: float, y: np.ndarray) -> np.ndarray:
        at = time / self._step
        sample = int(at)
        here = self._edges[sample]
        np.subtract(self._edges[sample + 1], here, out=self._shares)
        self._shares *= at - sample
        self._shares += here
        self._y[:] = y
        self._eval_rates()
        return self._rates

    def measure(self) -> np.ndarray:
        """Piston positions, then piston velocities, of the present state, (2 x cylinders,); overwritten next time."""
        self._y[:] = self.state
        self._eval_measure()
        return self._moved

    def advance(self, sample: int) -> np.ndarray:
        """The state at a later sample, (size,).

        Args:
            sample: Number of the sample.

        Raises:
            SolverError: The solver gave up; the text says why.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)
            try:
                self.state = self._solver.integrate(sample * self._step)
            except UserWarning as warning:
                raise SolverError(f"the solver gave up: {str(warning).removeprefix('vode: ')}") from None
        if not np.isfinite(self.state).all():
            raise SolverError("the solver gave up: the state is not finite")
        return self.state

"""Published values of the two papers, and the leanboom run that each is compared with.

*3-DOF* is Nurmi and Mattila, Automation in Construction 73 (2017); *4-DOF* is Nurmi and Mattila, Energies 10 (2017)
647. The second column of Tables 2 and 3 is from closed-loop simulations with pressure dynamics and friction. The bar
charts of the 4-DOF paper (Figures 10a-12a, A4-A6) have no numbers, and are measured on the real crane; only what the
text says of them can be compared.
"""

from __future__ import annotations

from dataclasses import dataclass

from leanboom.study.papers.weights import SIGNED


@dataclass(frozen=True, slots=True)
class Entry:
    """A row of a table or chart: its name, and our method and minimised cost for it."""

    name: str  # as printed
    method: str  # a name of `registry.METHODS`, or SIGNED
    cost: str
    value: float | None = None  # relative cost of the simplified model
    full: float | None = None  # of the full one


# 3-DOF, Table 2: pump flow of the largest triangle, relative to the least.
TABLE2 = (
    Entry("DP (CP)", "dp", "cp", 1.000, 1.000),
    Entry("DIDO (CP)", "pseudospectral", "cp", 1.003, 1.002),
    Entry("DP (LS)", "dp", "ls", 1.062, 1.060),
    Entry("DP (Act. velocity)", "dp", "velocity", 1.087, 1.086),
    Entry("DP (Pos. actuator)", "dp", "actuator", 1.098, 1.098),
    Entry("Act. p-inv. (Unweighted)", "sns-actuator", "velocity", 1.127, 1.124),
    Entry("fmincon (CP)", "shooting", "cp", 1.166, 1.163),
    Entry("Act. p-inv. (Weighted)", SIGNED, "velocity", 1.308, 1.308),
)

# 3-DOF, Table 3: LS energy of the largest triangle, relative to the least.
TABLE3 = (
    Entry("DP (LS)", "dp", "ls", 1.000, 1.000),
    Entry("DIDO (LS)", "pseudospectral", "ls", 1.087, 1.012),
    Entry("DP (Pos. actuator)", "dp", "actuator", 1.109, 1.027),
    Entry("fmincon (LS)", "shooting", "ls", 1.154, 1.050),
    Entry("DP (CP)", "dp", "cp", 1.201, 1.083),
    Entry("DP (Act. velocity)", "dp", "velocity", 1.247, 1.135),
    Entry("Act. p-inv. (Unweighted)", "sns-actuator", "velocity", 1.259, 1.154),
    Entry("Act. p-inv. (Weighted)", SIGNED, "velocity", 1.413, 1.293),
)

AS_WRITTEN = Entry("Act. p-inv. (Weighted by v'Av, as the text says)", "sns-actuator-weighted", "weighted-velocity")

# 3-DOF, sections 6.2 and 6.3: changes of cylinder sizes, in percent.
TILT_ROD = {
    "flow": {"large": -5.0, "medium": -4.0, "small": -4.0},
    "ls": {"large": 6.0},  # "almost 6%"
    "pressure": {"large": 5.0},  # "well over 5%"
}
EXTENSION_BORE = {"flow": {"large": -4.0}, "ls": {"large": -4.0}, "pressure": {"large": 0.0}}  # "negligible effect"

# 4-DOF, section 6: the solutions of Figures 10 to 12.
SOLUTIONS = (
    Entry("DP (LS)", "dp", "ls"),
    Entry("DIDO (LS)", "pseudospectral", "ls"),
    Entry("DP (CP)", "dp", "cp"),
    Entry("DIDO (CP)", "pseudospectral", "cp"),
    Entry("DP (A. En.)", "dp", "actuator"),
    Entry("DP (ext.)", "dp", "extension"),
    Entry("P-inv. (j.)", "sns-joint", "joint-velocity"),
    Entry("P-inv. (a.)", "sns-actuator", "velocity"),
)

# 4-DOF, sections 6.1 and 6.2: energy of a pseudo-inverse over that of the best solution, by path and pump.
EXCESS = {
    ("horizontal", "ls"): 1.25,  # "25% greater energy consumption"
    ("horizontal", "cp"): 1.30,  # "approximately 30% greater energy use"
    ("vertical", "ls"): 2.0,  # "almost twice the energy consumption"
}
CP_OVER_LS = {"vertical": 2.0}  # section 6.2: CP rates "approximately double compared to the LS case"
CP_BEST_OVER_LS_POINTWISE = {"horizontal": 1.0}  # section 6.1: "the same amount"

# 4-DOF, Table 4: maximum end-effector path tracking error by ISO 9283 [m], load sensing and constant pressure.
_ERRORS = {  # horizontal, vertical, half-cycle
    "DP (CP)": ((0.088, 0.070), (0.098, 0.091), (0.346, 0.129)),
    "DP (LS)": ((0.076, 0.073), (0.093, 0.087), (0.265, 0.117)),
    "DP (A. En.)": ((0.064, 0.064), (0.076, 0.085), (0.232, 0.111)),
    "DP (ext.)": ((0.146, 0.140), (0.085, 0.086), (0.210, 0.155)),
    "P-inv. (a.)": ((0.127, 0.069), (0.108, 0.095), (0.200, 0.219)),
    "P-inv. (j.)": ((0.057, 0.052), (0.098, 0.101), (0.343, 0.207)),
    "DIDO (CP)": ((0.064, 0.041), (0.077, 0.080), (0.277, 0.148)),
    "DIDO (LS)": ((0.063, 0.049), (0.079, 0.081), (0.245, 0.179)),
}
TABLE4 = {
    (path, name): row[i]
    for i, path in enumerate(("horizontal", "vertical", "half-cycle"))
    for name, row in _ERRORS.items()
}

"""Everything the README's table states, measured side by side in one run: `make bench`.

Sections: machine, start-up, speed of the sweep against Algorithm 1, planning time and memory, energies of every
method on every bundled task, start and pump, speed of the closed-loop simulation, order of convergence, independence
of the number of threads.
`--quick` leaves out the energy matrix; `--algorithm-1` adds whole runs of dp-paper (minutes), `--certificate` the gaps
of the certificate (an hour; `python -m benchmarks.certificate` has a choice of tasks).
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
import tempfile
import time
from dataclasses import replace

import numba
import numpy as np

import leanboom as lb
from benchmarks import certificate
from leanboom import resources
from leanboom.dynamic_programming import grids, value_function
from leanboom.evaluation.evaluate import judged_cost
from leanboom.methods import dp_paper
from leanboom.planning import planner
from leanboom.problem import stages, starts

GRID = (356, 101)
STARTS = ("smallest", "middle", "best")
BASELINES = ("sns-joint", "sns-actuator", "sns-actuator-weighted", "dp1", "polish")


def title(text: str) -> None:
    print(f"\n{text}\n{'-' * len(text)}", flush=True)


def machine() -> None:
    title("Machine")
    name = platform.processor() or platform.machine()
    try:
        with open("/proc/cpuinfo", encoding="ascii") as file:
            name = next(line.split(":")[1].strip() for line in file if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    print(f"{name}, {os.cpu_count()} cores, {resources.threads()} threads used by kernels")
    print(f"Python {platform.python_version()}, numpy {np.__version__}, numba {numba.__version__}, {platform.system()}")


def timed(command: list[str], environment: dict | None = None) -> tuple[float, str]:
    began = time.perf_counter()
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, env={**os.environ, **(environment or {})}
    )
    return time.perf_counter() - began, done.stdout


def start_up() -> None:
    title("Start-up")
    tool = [os.path.join(os.path.dirname(sys.executable), "leanboom")]
    seconds = sorted(timed([*tool, "--help"])[0] for _ in range(5))
    print(f"leanboom --help: {seconds[2]:.2f} s (median of 5, {seconds[0]:.2f} to {seconds[-1]:.2f})")
    code = (
        "import time; t = time.perf_counter(); from leanboom.dynamic_programming import value_function; "
        "from leanboom.fixed_mode import modes; value_function.prepare(); modes.prepare()"
    )
    code += "; print(time.perf_counter() - t)"
    with tempfile.TemporaryDirectory() as folder:
        cold = float(timed([sys.executable, "-c", code], {"NUMBA_CACHE_DIR": folder})[1])
        warm = float(timed([sys.executable, "-c", code], {"NUMBA_CACHE_DIR": folder})[1])
    print(f"kernels, first run ever (compilation): {cold:.1f} s; later runs: {warm:.2f} s")


def sweep_speed() -> None:
    title(f"One backward stage at {GRID[0]} x {GRID[1]}: compiled sweep against Algorithm 1 in NumPy (x 151 controls)")
    task = lb.load_task("forwarder-vertical")
    problem = stages.discretise(task, 0.05)
    for cost in ("cp", "ls"):
        ours = []
        for _ in range(3):
            began = time.perf_counter()
            value_function.solve(problem, grids.full_grid(problem, *GRID), cost)
            ours.append((time.perf_counter() - began) / problem.stages)
        model = dp_paper.model(task, cost)
        ahead = np.zeros((model.positions.size, model.velocities.size))
        theirs = []
        for _ in range(2):
            began = time.perf_counter()
            dp_paper.backward_stage(model, 60, ahead)
            theirs.append(time.perf_counter() - began)
        a, b = min(ours), min(theirs)
        states = GRID[0] * GRID[1]
        print(
            f"{cost}: {1e3 * a:.2f} ms a stage, tables included ({1e9 * a / states:.0f} ns a state); "
            f"Algorithm 1 {b:.2f} s; ratio {b / a:.0f}"
        )


def planning() -> None:
    title("Planning the half-cycle, warm, whole process")
    code = (
        "import leanboom as lb; from leanboom import resources; t = lb.load_task('forwarder-half-cycle'); "
        "lb.plan(t, pump={pump!r}); m = lb.plan(t, pump={pump!r}); "
        "print(m.solve_s, resources.peak_memory())"
    )
    for pump in ("ls", "cp"):
        runs = [timed([sys.executable, "-c", code.format(pump=pump)])[1].split() for _ in range(3)]
        seconds = sorted(float(run[0]) for run in runs)
        peak = max(float(run[1]) for run in runs)
        print(
            f"{pump}: solved in {seconds[1]:.2f} s (median of 3, {seconds[0]:.2f} to {seconds[-1]:.2f}); "
            f"peak memory {peak / 2**20:.0f} MiB, {8 * 2**30 / peak:.0f} times below the papers' 8 GB"
        )
    code = (
        "import leanboom as lb; from leanboom import resources; from leanboom.problem import stages; "
        "from leanboom.dynamic_programming import grids, value_function; "
        "p = stages.discretise(lb.load_task('forwarder-vertical'), 0.05); "
        "value_function.solve(p, grids.full_grid(p, 356, 101), 'ls'); "
        "print(resources.peak_memory())"
    )
    peak = float(timed([sys.executable, "-c", code])[1])
    print(f"sweep alone at 356 x 101: peak memory {peak / 2**20:.0f} MiB, {8 * 2**30 / peak:.0f} times below 8 GB")


def energies() -> None:
    title("Judged energy [kJ] of every method; (!) breaks a limit, x: no motion; gap: best other feasible against dp")
    print(
        f"{'task':<24}{'start':<9}{'pump':<5}{'dp':>8} "
        + "".join(f"{name[:13]:>14}" for name in BASELINES)
        + "     gap    s"
    )
    worst = np.inf
    for name in certificate.SINGLE:
        for start in STARTS:
            task = replace(lb.load_task(name), start=start)
            for pump in ("ls", "cp"):
                plan = planner.run(task, pump=pump, baseline=False, check=False)
                ours = plan.evaluation.energy(pump)
                cells, others = [], []
                for method in BASELINES:
                    try:
                        other = planner.run(task, pump=pump, method=method, baseline=False, check=False).evaluation
                        cells.append(f"{other.energy(pump) / 1e3:.2f}{'' if other.feasible else '(!)'}")
                        others += [other.energy(pump)] if other.feasible else []
                    except lb.LeanboomError:
                        cells.append("x")
                gap = min(others, default=np.inf) / ours - 1.0
                worst = min(worst, gap)
                mark = "" if plan.evaluation.feasible else "(!)"
                print(
                    f"{name:<24}{start:<9}{pump:<5}{ours / 1e3:>8.2f}{mark:<1}"
                    + "".join(f"{cell:>14}" for cell in cells)
                    + f"{100 * gap:>+7.2f}%{plan.motion.solve_s:>6.2f}",
                    flush=True,
                )
    print(f"smallest lead of dp over any other feasible motion: {100 * worst:+.3f} %")


def vertical() -> None:
    title("forwarder-vertical, start smallest: what the steps of the planner are worth [kJ]")
    task = lb.load_task("forwarder-vertical")
    problem = stages.discretise(task, 0.05)
    for pump in ("cp", "ls"):
        rows = [
            (
                "actuator pseudo-inverse",
                planner.run(task, pump=pump, method="sns-actuator", baseline=False, check=False).evaluation,
            )
        ]
        for grid in ((201, 101), GRID, (801, 201)):
            policy = value_function.solve(problem, grids.full_grid(problem, *grid), pump)
            rows.append(
                (
                    f"dynamic program {grid[0]}x{grid[1]} alone",
                    lb.evaluate(task, value_function.rollout(policy, problem.lower[0])),
                )
            )
        plan = planner.run(task, pump=pump, baseline=False, check=False).evaluation
        rows.append(("planner: + tubes + polish", plan))
        for name, judged in rows:
            use = judged.limit_use
            print(
                f"{pump}  {name:<34}{judged.energy(pump) / 1e3:>8.3f}   limit use {use.worst:.4f}   "
                f"path error {1e3 * judged.path_error:.1e} mm"
            )


def algorithm_1() -> None:
    title("forwarder-vertical by dp-paper (Algorithm 1, 356 x 101 x 151), start smallest")
    task = lb.load_task("forwarder-vertical")
    for pump in ("cp", "ls"):
        plan = planner.run(task, pump=pump, method="dp-paper", baseline=False, check=False)
        print(
            f"{pump}: {plan.evaluation.energy(pump) / 1e3:.2f} kJ in {plan.motion.solve_s:.0f} s, {plan.motion.status}"
        )


def convergence() -> None:
    title("Error of the coarse dynamic program against the grid (forwarder-vertical, middle, cp; value at the start)")
    task = replace(lb.load_task("forwarder-vertical"), start="middle")
    problem = stages.discretise(task, 0.05)
    start = starts.start_position(problem, "middle")
    exact = judged_cost(planner.run(task, pump="cp", baseline=False, check=False).evaluation, "cp")
    sizes, errors = [], []
    for n in (1, 2, 4, 8, 16):
        grid = (25 * n + 1, 24 * n + 1)
        policy = value_function.solve(problem, grids.full_grid(problem, *grid), "cp")
        error = lb.evaluate(task, value_function.rollout(policy, start)).energy_cp / exact - 1.0
        sizes.append(1.0 / n)
        errors.append(max(error, 1e-9))
        print(f"{grid[0]:>5} x {grid[1]:<5} {100 * error:8.3f} %")
    order = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    print(f"order (slope of log error over log spacing): {order:.2f}")


def simulation() -> None:
    title("Closed-loop simulation, warm, one thread")
    for name in ("forwarder-half-cycle", "loader-triangle-large"):
        task = lb.load_task(name)
        motion = planner.run(task, method="sns-actuator", baseline=False, check=False).motion
        began = time.perf_counter()
        lb.simulate(task, motion, "ls")
        first = time.perf_counter() - began
        for pump in ("ls", "cp"):
            runs = sorted((lb.simulate(task, motion, pump) for _ in range(3)), key=lambda run: run.wall_s)
            run = runs[1]
            print(
                f"{name}, {pump}: {run.time[-1]:.0f} s in {run.wall_s:.2f} s ({runs[0].wall_s:.2f} to "
                f"{runs[2].wall_s:.2f}), {run.realtime_factor:.0f} times real time; {run.energy / 1e3:.2f} kJ (planned "
                f"{run.planned_energy / 1e3:.2f}), path accuracy {run.path_accuracy:.3f} m, balance error "
                f"{100 * run.balance_error:.5f} %"
            )
        print(f"{name}: first run of a process, plant built and valve measured: {first:.2f} s")


def threads() -> None:
    title("Same bits on one and two threads")
    problem = stages.discretise(lb.load_task("forwarder-vertical"), 0.05)
    values = []
    before, most = os.environ.get("LEANBOOM_THREADS"), max(2, resources.threads())
    for count in (1, most):
        os.environ["LEANBOOM_THREADS"] = str(count)
        values.append(value_function.solve(problem, grids.full_grid(problem, 201, 101), "ls").values)
    os.environ.pop("LEANBOOM_THREADS")
    if before is not None:
        os.environ["LEANBOOM_THREADS"] = before
    print(f"1 and {most} threads: {'equal' if np.array_equal(*values) else 'DIFFERENT'}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="leave out the energies of all methods")
    parser.add_argument("--algorithm-1", action="store_true", help="also run dp-paper in full (minutes)")
    parser.add_argument("--certificate", action="store_true", help="also prove lower bounds for all tasks (an hour)")
    arguments = parser.parse_args()
    began = time.perf_counter()
    machine()
    start_up()
    value_function.prepare()
    sweep_speed()
    planning()
    vertical()
    simulation()
    convergence()
    threads()
    if not arguments.quick:
        energies()
    if arguments.algorithm_1:
        algorithm_1()
    if arguments.certificate:
        title("Certificate: gap against time")
        certificate.table(list(certificate.SINGLE), list(STARTS), list(certificate.PUMPS), 120.0, 0.5)
    peak = resources.peak_memory() / 2**20
    print(f"\nall of this: {time.perf_counter() - began:.0f} s, peak memory {peak:.0f} MiB")


if __name__ == "__main__":
    main()

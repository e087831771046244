"""The commands that plan one task: `plan`, `certify`, `simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from leanboom.cli.terminal import (
    GRID,
    STEP,
    Effort,
    End,
    FlowLimit,
    Json,
    Progress,
    Pump,
    Start,
    Step,
    Task,
    bundled,
    complain,
    duration,
    percent,
    print_json,
    settings,
)
from leanboom.errors import InputError
from leanboom.planning import summaries


def plan(
    task: Task,
    pump: Pump = "ls",
    cost: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="What to minimise, if not the pump's energy: ls, cp, actuator, velocity, extension, recuperation.",
        ),
    ] = None,
    method: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="dp (the planner), {methods}.",
        ),
    ] = "dp",
    start: Start = None,
    end: End = None,
    flow_limit: FlowLimit = False,
    grid: Annotated[
        str, typer.Option(metavar="PxV", help="Positions and velocities of the extension on the coarse grid.")
    ] = GRID,
    step: Step = STEP,
    effort: Effort = "default",
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Write a run folder: report, trajectory, task, machine and summary."),
    ] = None,
    certified: Annotated[
        bool,
        typer.Option("--certify", help="Prove how far from the optimum the plan can be (a minute; see certify)."),
    ] = False,
    seconds: Annotated[
        str | None,
        typer.Option(metavar="TIME", help="Time of that proof; by default 60 s, with --effort thorough 300 s."),
    ] = None,
    gap: Annotated[
        str | None,
        typer.Option(
            metavar="PERCENT", help="Gap at which it ends; by default 0.5, with --effort thorough 1 (ls) or 0.3 (cp)."
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Plan the motion that takes the least pump energy."""
    nodes, stage = settings(grid, step)
    from leanboom.io import loading
    from leanboom.report import run_folder

    asked = loading.load_task(task, start=start, end=end, pump_flow_limit=flow_limit or None)
    from dataclasses import replace

    from leanboom.certificate import certificate
    from leanboom.planning import planner

    limit = None if seconds is None else duration("seconds", seconds)
    least = None if gap is None else percent("gap", gap)
    with Progress() as tell, run_folder.reserved(out):
        result = planner.run(
            asked, pump=pump, cost=cost, method=method, grid=nodes, step=stage, effort=effort,
            seconds=limit or planner.PROOF_SECONDS, gap=least, check=False, progress=tell,
        )  # fmt: skip
        if certified and result.certificate is None and result.evaluation.feasible:
            proof = certificate.certify(
                result.task, pump, motion=result.motion, step=stage, seconds=limit or certificate.SECONDS,
                gap=certificate.GAP if least is None else least, progress=tell,
            )  # fmt: skip
            result = replace(result, certificate=proof)
        if out is not None:
            tell("writing the run folder", 1.0)
            run_folder.write(result, out, nodes)
        proof = result.certificate
    if as_json:
        print_json(summaries.summary(result, out) | ({} if proof is None else proof.json()))
    else:
        from leanboom.cli import result_tables
        from leanboom.cli.console import output

        source = asked.machine.name if task in loading.bundled_tasks() else task
        result_tables.plan(output(), result, out, source)
        if proof is not None:
            from leanboom.cli import proof_tables

            proof_tables.certificate(output(), proof)
    if not result.solved:
        complain(result.status)
    if not result.evaluation.feasible:
        raise typer.Exit(1)


def certify(
    task: Task,
    pump: Pump = "ls",
    start: Start = None,
    end: End = None,
    flow_limit: FlowLimit = False,
    step: Step = STEP,
    seconds: Annotated[
        str,
        typer.Option(
            metavar="TIME",
            help="Processor time for bounding; by the clock twice as long at most, but until there is a bound.",
        ),
    ] = "60 s",
    gap: Annotated[str, typer.Option(metavar="PERCENT", help="Gap at which bounding ends.")] = "0.5",
    as_json: Json = False,
) -> None:
    """Plan a task and prove how far from the optimum the plan can be."""
    _, stage = settings(GRID, step)
    from leanboom.certificate import certificate
    from leanboom.io import loading
    from leanboom.planning import planner

    limit, least = duration("seconds", seconds), percent("gap", gap)
    certificate.check(pump, stage, limit, least)
    asked = loading.load_task(task, start=start, end=end, pump_flow_limit=flow_limit or None)
    with Progress() as tell:
        result = planner.run(asked, pump=pump, step=stage, baseline=False, progress=tell)
        proof = certificate.certify(
            result.task, pump, motion=result.motion, step=stage, seconds=limit, gap=least, progress=tell
        )
    if as_json:
        print_json(summaries.summary(result) | proof.json())
    else:
        from leanboom.cli import proof_tables
        from leanboom.cli.console import output

        proof_tables.certificate(output(), proof)
    if not result.solved:
        complain(result.status)


def simulate(
    task: Annotated[
        str,
        typer.Argument(
            metavar="TASK|RUN",
            help="A bundled task, a task file, or the run folder of a plan.",
            autocompletion=bundled("task"),
        ),
    ],
    pump: Annotated[
        str | None, typer.Option(help="ls or cp. By default that of the run folder; of a task, ls.")
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="How a task is planned first: a method of `leanboom plan`; by default dp."),
    ] = None,
    controller: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="{controllers}. By default the one of the papers for the machine's valve."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Write a run folder with the simulation. By default a RUN gets it added."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Drive a plan in closed loop: pump, valves, oil and controller."""
    from leanboom.components.costs import PUMPS
    from leanboom.io import loading
    from leanboom.planning import planner
    from leanboom.quantities.ranges import one_of
    from leanboom.report import run_folder, simulation_page
    from leanboom.simulation import closed_loop
    from leanboom.simulation.registry import CONTROLLERS

    if pump is not None:
        one_of("pump", pump, PUMPS)
    if controller is not None:
        CONTROLLERS.find(controller)
    run = Path(task) if task not in loading.bundled_tasks() and Path(task).is_dir() else None
    if run is not None and method is not None:
        raise InputError(f"method = {method}; the run folder {task} is planned already: leave --method out")
    kept = None if run is None else run_folder.read(run)
    out = out or run
    with Progress() as tell, run_folder.reserved(out):
        if kept is None:
            asked = loading.load_task(task)
            plan = planner.run(asked, pump=pump or "ls", method=method or "dp", check=False, progress=tell)
            result = closed_loop.simulate(plan.task, plan.motion, plan.pump, controller=controller, progress=tell)
            if out is not None:
                tell("writing the run folder", 1.0)
                run_folder.write(plan, out, simulation=result)
        else:
            assert run is not None and out is not None
            asked, motion, planned_for = kept
            result = closed_loop.simulate(asked, motion, pump or planned_for, controller=controller, progress=tell)
            tell("writing the run folder", 1.0)
            run_folder.add(run, out, result)
    if as_json:
        print_json(simulation_page.summary(result, out))
    else:
        from leanboom.cli import result_tables
        from leanboom.cli.console import output

        result_tables.simulation(output(), result, out)
    if not result.solved:
        complain(result.verdict)
    if not (result.complete and result.planned.feasible):
        raise typer.Exit(1)

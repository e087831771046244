"""Builds of a library, in processes of this machine or on a Dask cluster: sweeps go out, results come back one by one.

This process alone writes. A sweep that is done is in the library before the next one is looked at; whatever ends a
build, the next one goes on from there. A worker that dies costs the sweep it was at, which is planned again.
"""

from __future__ import annotations

import json
import os
import re
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent import futures
from concurrent.futures.process import BrokenProcessPool, ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import version
from multiprocessing import connection, parent_process
from pathlib import Path
from typing import Any

from leanboom import compiling, resources
from leanboom.dynamic_programming import value_function
from leanboom.errors import InputError, LeanboomError
from leanboom.fixed_mode import modes
from leanboom.io import folders, loading
from leanboom.library import keys, specification
from leanboom.library.specification import Family, Specification, Sweep
from leanboom.library.store import INDEX, MACHINE, SPECIFICATION, Entry, Store, arrow
from leanboom.library.warm_starts import Known, Result, plan_sweep
from leanboom.progress import Progress, quiet

ATTEMPTS = 3  # at a sweep whose worker dies
COMPACTED = 256  # writes after which small files are put together
REACHED = 20.0  # [s] to wait for a cluster
LOCAL = "local"  # a Dask cluster of this machine

Work = Callable[[Sweep, tuple[Known, ...]], tuple[Result, ...]]


@dataclass(frozen=True, slots=True)
class Summary:
    """What a build did."""

    total: int  # motions that the specification asks for
    solved: int  # that have a solution, earlier ones included
    infeasible: int  # that have none
    reused: int  # found by earlier builds
    failed: int  # whose worker died again and again; the next build tries again
    build_s: float
    reasons: dict[str, int]  # why motions are infeasible or failed, the most frequent first

    def json(self) -> dict[str, Any]:
        """The numbers as `--json` has them."""
        return {name: value for name, value in asdict(self).items() if name != "reasons"}


def build(
    made: Specification,
    out: Path,
    *,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress | None = None,
    work: Work = plan_sweep,
) -> Summary:
    """Build a library, or go on with one: what is there already is kept.

    Args:
        made: Which motions it holds.
        out: Its folder; new, empty, or that of a library of the same machine.
        workers: Processes; None: one a core. Without a meaning on a cluster that is there already.
        cluster: Address of a Dask scheduler, or "local" for a cluster of this machine; None: processes without Dask.
        progress: Called with what happens and the share done.
        work: What plans a sweep.

    Returns:
        What was done.

    Raises:
        InputError: The folder holds something else or a library of another machine, cannot be written, or another
            build is at work there; or the cluster cannot be reached.
        LeanboomError: pyarrow or Dask is not installed.
    """
    tell = progress or quiet
    arrow()
    began = time.perf_counter()
    _check_place(out)
    workers = workers or resources.cores()
    tell("loading kernels", 0.0)
    with compiling.told(tell):  # once, before workers all meet them
        value_function.prepare()
        modes.prepare()
    with folders.opened(out), Store(out, write=True) as store:
        reused = _prepare(store, made)
        with _dask(cluster, workers) if cluster else _Processes(workers) as pool:
            run = _Run(made, store, pool, work, tell)
            run.all()
        store.compact()
        return run.summary(reused, time.perf_counter() - began)


def _check_place(out: Path) -> None:
    """Raise InputError for a folder that holds something else."""
    with folders.explained(out):
        if out.exists() and not out.is_dir():
            raise InputError(f"out = {out}; is a file: give a new or empty folder, or that of a library")
        strange = out.is_dir() and not (out / INDEX).exists() and any(not p.name.startswith(".") for p in out.iterdir())
    if strange:
        raise InputError(f"out = {out}; holds no library: give a new or empty folder, or that of a library")


def _prepare(store: Store, made: Specification) -> int:
    """Make a library ready for a build; number of its motions that are used again."""
    facts = store.facts()
    name, end = made.machine.name, str(made.keys.end)
    if facts.get("machine", name) != name:
        raise InputError(
            f"out = {store.folder}; is a library of machine {facts['machine']}, not {name}: give another folder"
        )
    if "machine" in facts and facts.get("end", "free") != end:
        raise InputError(
            f"out = {store.folder}; is a library of motions with end {facts.get('end', 'free')}, not {end}: give "
            "another folder"
        )
    store.forget(set(keys.machine_keys(made.machine).values()))
    texts = {MACHINE: loading.dump_machine(made.machine), SPECIFICATION: made.text}
    folders.write(store.folder, {file: text.encode() for file, text in texts.items()})
    store.note(machine=name, name=made.name, end=end, leanboom=version("leanboom"))
    known = store.keys()
    return sum(key in known for family in made.families() for sweep in family.sweeps for key in _keys(made, sweep))


def _keys(made: Specification, sweep: Sweep) -> list[str]:
    machine = keys.machine_key(made.machine, sweep.pump, sweep.tasks[0].payload > 0.0)
    return [keys.motion_key(task, sweep.pump, machine) for task in sweep.tasks]


class _Course:
    """A family on its way: which of its sweeps have begun, and what those that are done leave to begin others with."""

    def __init__(self, family: Family):
        self.family = family
        self.started: set[int] = set()
        self.motions: dict[int, tuple[Known, ...]] = {}  # by sweep that is done

    def next(self) -> int | None:
        """A sweep that may start now, if there is one: the first, or one whose parent is done."""
        for number, parent in enumerate(self.family.parents):
            if number not in self.started and (parent is None or parent in self.motions):
                self.started.add(number)
                return number
        return None


@dataclass(slots=True)
class _Flight:
    """A sweep that a worker is at, or will be."""

    course: _Course
    number: int
    sweep: Sweep  # with the tasks alone that are not in the library
    near: tuple[Known, ...]  # motions to begin with
    stored: tuple[Known, ...]  # those of the sweep that are in the library
    attempts: int = 0


class _Run:
    """One run over all families."""

    def __init__(self, made: Specification, store: Store, pool: Any, work: Work, tell: Progress):
        self.made, self.store, self.pool, self.work, self.tell = made, store, pool, work, tell
        self.began = time.perf_counter()
        self.known = store.keys()
        self.flights: dict[futures.Future, _Flight] = {}
        self.waiting: list[_Flight] = []
        self.failures: Counter[str] = Counter()
        self.done = self.planned = self.writes = 0

    def all(self) -> None:
        """Plan what is not in the library."""
        families = self.made.families()
        family: Family | None = next(families, None)
        while family is not None or self.flights or self.waiting:
            while family is not None and len(self.waiting) + len(self.flights) < self.pool.room:
                self.go_on(_Course(family))
                family = next(families, None)
            self.submit()
            ended = futures.wait(self.flights, return_when=futures.FIRST_COMPLETED).done if self.flights else set()
            taken = [(self.flights.pop(each), each) for each in ended]
            self.submit()  # before results are written, for which workers would wait
            for flight, each in taken:
                self.take(flight, each)

    def submit(self) -> None:
        """Hand sweeps that wait to workers that are free."""
        while self.waiting and len(self.flights) < self.pool.slots:
            flight = self.waiting.pop(0)
            self.flights[self.pool.submit(self.work, flight.sweep, flight.near)] = flight

    def go_on(self, course: _Course) -> None:
        """Queue the sweeps of a family that may start now, passing over those that are in the library."""
        while (number := course.next()) is not None:
            sweep, parent = course.family.sweeps[number], course.family.parents[number]
            names = _keys(self.made, sweep)
            missing = tuple(task for task, key in zip(sweep.tasks, names, strict=True) if key not in self.known)
            stored = self.stored(sweep, names) if len(missing) < len(names) else ()
            self.done += len(names) - len(missing)
            if missing:
                near = (*stored, *(() if parent is None else course.motions[parent]))
                self.waiting.insert(0, _Flight(course, number, Sweep(missing, sweep.pump), near, stored))
            else:
                course.motions[number] = stored

    def stored(self, sweep: Sweep, names: list[str]) -> tuple[Known, ...]:
        """What the library holds of a sweep."""
        found = []
        for task, key in zip(sweep.tasks, names, strict=True):
            for entry in self.store.entries("key = ? AND segment NOTNULL", (key,)):
                found.append(Known(task, self.store.motion(entry)))
        return tuple(found)

    def take(self, flight: _Flight, ended: futures.Future) -> None:
        """What became of a sweep: its motions go into the library, or it is planned again."""
        try:
            results = ended.result()
        except BrokenProcessPool:
            flight.attempts += 1
            if flight.attempts < ATTEMPTS:
                self.waiting.append(flight)
                return
            self.fail(flight, f"its worker died {ATTEMPTS} times")
        except MemoryError:
            self.fail(flight, "out of memory")
        except Exception as error:  # whatever a sweep does wrong is the fate of that sweep alone
            self.fail(flight, f"{type(error).__name__}: {error}")
        else:
            self.keep(flight, results)
        self.go_on(flight.course)

    def fail(self, flight: _Flight, why: str) -> None:
        """Count a sweep as failed; the next build tries again."""
        self.failures[why] += len(flight.sweep.tasks)
        self.done += len(flight.sweep.tasks)
        flight.course.motions[flight.number] = flight.stored
        self.report()

    def keep(self, flight: _Flight, results: tuple[Result, ...]) -> None:
        """Write a sweep's results; from here on they are not lost."""
        sweep, family = flight.sweep, flight.course.family
        machine = keys.machine_key(self.made.machine, sweep.pump, sweep.tasks[0].payload > 0.0)
        shape = json.dumps(keys.plain(self.made.keys.shape), sort_keys=True)
        entries = []
        for task, key, result in zip(sweep.tasks, _keys(self.made, sweep), results, strict=True):
            entry = Entry(
                key, machine, family.origin, family.goal, shape, sweep.pump, task.payload, task.duration,
                str(task.start), result.start_m, result.end_m, result.solved, result.status, result.energy_j,
                result.pseudo_inverse_j, result.solve_s, None, None,
            )  # fmt: skip
            entries.append((entry, result.motion))
        self.store.add(entries)
        found = zip(sweep.tasks, results, strict=True)
        fresh = tuple(Known(task, each.motion) for task, each in found if each.motion is not None)
        flight.course.motions[flight.number] = flight.stored + fresh
        self.done += len(results)
        self.planned += len(results)
        self.writes += 1
        if self.writes % COMPACTED == 0:
            self.store.compact()
        self.report()

    def report(self) -> None:
        """Say how far the build is, how fast, and how long it will take."""
        total = self.made.total
        rate = self.planned / max(time.perf_counter() - self.began, 1e-9)
        left = f"about {specification.lasting((total - self.done) / rate)} left" if rate else "no rate yet"
        share = max(self.done / total, 1e-3)
        self.tell(f"{self.done} of {total} motions, {rate:.2f} a second, {left}", share)

    def summary(self, reused: int, build_s: float) -> Summary:
        """What was done, counted in the library."""
        reasons = Counter(self.failures)
        solved = infeasible = 0
        for family in self.made.families():
            for sweep in family.sweeps:
                for key in _keys(self.made, sweep):
                    for entry in self.store.entries("key = ?", (key,)):
                        solved += entry.solved
                        infeasible += not entry.solved
                        if not entry.solved:
                            reasons[_without_numbers(entry.status)] += 1
        failed = self.made.total - solved - infeasible
        return Summary(self.made.total, solved, infeasible, reused, failed, build_s, dict(reasons.most_common()))


def _without_numbers(status: str) -> str:
    """A status without its particulars, so that those of one kind count together."""
    return re.sub(r"\s*(at|by)? -?\d[\d.]*( (s|m|rad|m/s|m/s\^2|MPa|l/min|%))?( \(stage \d+\))?", " ...", status)


class _Processes:
    """Processes of this machine, each on one thread; each is a pool of its own, so that its end concerns no other."""

    def __init__(self, workers: int):
        self.slots, self.room = workers, workers + 1
        self._idle = [self._pool() for _ in range(workers)]
        self._busy: dict[futures.Future, ProcessPoolExecutor] = {}

    def __enter__(self) -> _Processes:
        return self

    def __exit__(self, *_: object) -> None:
        for pool in (*self._idle, *self._busy.values()):
            for process in list((pool._processes or {}).values()):  # what they are at would be waited for
                process.terminate()
            pool.shutdown(cancel_futures=True)

    def _pool(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(1, resources.process_context([__name__]), _begin)

    def submit(self, work: Work, sweep: Sweep, near: tuple[Known, ...]) -> futures.Future:
        """Have a sweep planned by a process that is idle."""
        for ended in [each for each in self._busy if each.done()]:
            self._idle.append(self._busy.pop(ended))
        pool = self._idle.pop()
        try:
            future = pool.submit(work, sweep, near)
        except BrokenProcessPool:  # it died over its last sweep, or since
            pool.shutdown(wait=False)
            pool = self._pool()
            future = pool.submit(work, sweep, near)
        self._busy[future] = pool
        return future


def _begin() -> None:
    """What a process does first: one thread, no output, and an end together with the build's process."""
    resources.quieten()
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    """End this process when another one ends, however that does."""
    connection.wait([sentinel])
    os._exit(1)


class _Dask:
    """A Dask cluster."""

    def __init__(self, client: Any, workers: int):
        self.slots = self.room = workers + 1
        self._pool = client.get_executor(pure=False)

    def submit(self, work: Work, sweep: Sweep, near: tuple[Known, ...]) -> futures.Future:
        """Have a sweep planned."""
        return self._pool.submit(_on_worker, work, sweep, near)


def _on_worker(work: Work, sweep: Sweep, near: tuple[Known, ...]) -> tuple[Result, ...]:
    """What a worker of a cluster does."""
    resources.single_thread()
    return work(sweep, near)


@contextmanager
def _dask(address: str, workers: int) -> Iterator[_Dask]:
    """A cluster at an address, or one of this machine."""
    try:
        from dask import config
        from distributed import Client, LocalCluster
    except ImportError:
        raise LeanboomError("--cluster needs Dask; install it with: pip install 'leanboom[cluster]'") from None
    with config.set({"distributed.comm.timeouts.connect": REACHED}), ExitStack() as until:
        if address == LOCAL:
            local = LocalCluster(n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0")
            client = until.enter_context(Client(until.enter_context(local)))
        else:
            try:
                client = until.enter_context(Client(address, timeout=REACHED))
            except (OSError, ValueError, TimeoutError) as error:
                raise InputError(f"cluster = {address}; cannot be reached: {error}") from None
            workers = sum(dict(client.nthreads()).values())  # type: ignore[call-overload]
            if not workers:
                raise InputError(f"cluster = {address}; has no workers: start some with dask worker {address}")
        yield _Dask(client, workers)

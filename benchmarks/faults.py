"""Whether mutated files, mutated machines or killed runs break anything: `python -m benchmarks.faults`.

Three parts. Files: the bundled machines and tasks with keys, values and bytes changed; each loads or is refused in a
text that can be read, and what loads can be checked, written and loaded again. Plans: bundled tasks on machines whose
numbers are 0.3 to 3 times as large; every number is finite, a solved plan keeps its limits when it is judged again,
and no other method is ahead. Kills: `leanboom plan --out` stopped at random instants; its folder is complete or absent,
and the next run leaves nothing hidden beside it.
Every case is drawn from the seed and its number, the same on every machine. Prints counts and every find; the exit
code is 1 if there is any.
"""

from __future__ import annotations

import argparse
import io
import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.random import Generator
from rich.console import Console

import leanboom as lb
from leanboom.cli import machine_tables
from leanboom.io import loading
from leanboom.planning import planner, summaries
from leanboom.report import facts, run_folder

DATA = Path(lb.__file__).parent / "data"
TEXTS = {
    kind: {path.stem: path.read_text(encoding="utf-8") for path in sorted((DATA / f"{kind}s").glob("*.yaml"))}
    for kind in ("machine", "task")
}
LONGEST = 10_000  # characters of a message
SLOWEST = 2.0  # processor time of loading a file [s]
AHEAD = 1e-3  # a lead of another method that is smaller than this share counts as level
OTHERS = ("sns-actuator", "dp1", "polish")
GRID, STEP = (31, 21), 0.2  # coarse: the faults looked for are not those of the grid
FACTORS = 0.3, 3.0

# Values in place of others, as they stand in a file.
ODD = (
    ".nan", "-.nan m", "nan", ".inf", "-.inf", "inf m", "1e309", "1e308 m", "-1e308", "1e-320 m", "9" * 400, "0",
    "-0.0", "-1", "-3 m", "0 deg", "1e6 m", "1e-9 mm", "90000 deg", "null", "~", "", "true", "no", "''", '" "', "!",
    "word", "[]", "{}", "[1, 2]", "[[0, 0, 0]]", "{a: 1}", "[null, null]", "{1: 2}", "3 kg", "3 furlong", "3 m m",
    "3 m^-1", "3 m/", "3m", "3 %", "1e5 GPa", "2 in", "٣ m", "३", "三 m", "½ m", "1,5 m", "1_000 m", "0x1F", "0o17",
    "1:30", "+", "-", "1e", "--3 m", "3 m # note", "2017-05-06", "!!python/object:os.system x", "!!binary aGk=",
    "!!set {a}", "!m 3 m", "!!float 3", "!!str 3 m", "!!timestamp 2001-01-01", "*nothing", "&a 3 m", "&a [*a]",
    "| \n  3 m", ">\n 3 m", "? 3", "%", "@", "`", "'3 m", '"\\uD800"', '"\\0"', "\u2028", "\ufeff", "\u202e3 m",
    "<script>alert(1)</script>", "../../etc/passwd", "x" * 5000, "é", "🏗", "lines", "spline", "triangle", "four_bar",
    "polynomial", "telescope", "forwarder", "CON",
)  # fmt: skip
KEYS = (
    "<<", "1", "null", "true", "? [1, 2]", "é", "name", "path", "type", "machine", "x" * 300, ".", "a.b", "'",
    "!!set",
)  # fmt: skip
BYTES = (
    b"\0", b"\xff\xfe", b"\xc3", b"\t", b"\r", b"\n", b"\x1b[2J", b"\x85", b":", b"- ", b"{", b"]", b"#", b"---\n",
    b"...\n",
)  # fmt: skip
WORD = re.compile(r"(?<=[:\[,-] )\s*[^\s,\[\]{}#:-][^,\[\]{}#\n:]*|(?<=[\[{])[^\s,\[\]{}#:][^,\[\]{}#\n:]*")
KEY = re.compile(r"[A-Za-z_][\w]*(?=:( |$))")
NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.^])")
COMMENT = re.compile(r" +#.*")


@dataclass(frozen=True, slots=True)
class Find:
    """What must not be: where it was met, and how it shows."""

    case: str  # the part and the number of the case
    what: str
    text: str = ""  # the file, or what the program said

    def __str__(self) -> str:
        return f"FIND {self.case}: {self.what}" + (f"\n{self.text}" if self.text else "")


@dataclass(slots=True)
class Tally:
    """What came of a part's cases."""

    counts: Counter[str] = field(default_factory=Counter)
    finds: list[Find] = field(default_factory=list)

    def __str__(self) -> str:
        return ", ".join(f"{number} {what}" for what, number in sorted(self.counts.items())) + (
            f"; finds: {len(self.finds)}"
        )


class _Wrong(Exception):
    """Something that must not be, met within a case."""


def _require(kept: bool, what: str) -> None:
    if not kept:
        raise _Wrong(what)


@contextmanager
def _watched(tally: Tally, case: str, text: Callable[[], str]) -> Iterator[None]:
    """Count how a case ends; whatever is neither an end nor a refusal is a find."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            yield
    except lb.LeanboomError as error:
        if len(str(error)) >= LONGEST:
            tally.finds.append(Find(case, f"refused in {len(str(error))} characters", text()))
        tally.counts["refused"] += 1
    except _Wrong as wrong:
        tally.finds.append(Find(case, str(wrong), text()))
    except Exception:
        tally.finds.append(Find(case, traceback.format_exc(), text()))


# Files


def mutated(text: str, other: str, rng: Generator) -> bytes:
    """A file's text with one to four things changed.

    Args:
        text: The text.
        other: Another file's, of which lines are taken.
        rng: What is drawn from.
    """
    for _ in range(int(rng.choice([1, 1, 1, 2, 4]))):
        text = MUTATIONS[int(rng.integers(len(MUTATIONS)))](text, other, rng)
    data = text.encode("utf-8", "surrogatepass")
    if rng.random() < 0.1:  # bytes, after which the text need not be one
        at = int(rng.integers(len(data) + 1))
        end = at + int(rng.choice([0, 0, 1, 5, len(data)]))
        data = data[:at] + (BYTES[int(rng.integers(len(BYTES)))] if rng.random() < 0.7 else b"") + data[end:]
    return data


def _line(lines: list[str], rng: Generator) -> int:
    """A line that says something."""
    said = [i for i, line in enumerate(lines) if COMMENT.sub("", line).strip() and not line.startswith("#")]
    return int(rng.choice(said)) if said else int(rng.integers(max(1, len(lines))))


def _drop(text: str, other: str, rng: Generator) -> str:
    lines = text.split("\n")
    at = _line(lines, rng)
    del lines[at : at + int(rng.choice([1, 1, 1, 2, 8]))]
    return "\n".join(lines)


def _duplicate(text: str, other: str, rng: Generator) -> str:
    lines = text.split("\n")
    at, to = _line(lines, rng), _line(lines, rng)
    size = int(rng.choice([1, 1, 4, 20]))
    place = at if rng.random() < 0.5 else to
    lines[place:place] = lines[at : at + size]
    return "\n".join(lines)


def _splice(text: str, other: str, rng: Generator) -> str:
    lines, theirs = text.split("\n"), other.split("\n")
    at, here = _line(lines, rng), _line(theirs, rng)
    lines[at : at + int(rng.integers(3))] = theirs[here : here + int(rng.choice([1, 3, 15]))]
    return "\n".join(lines)


def _indent(text: str, other: str, rng: Generator) -> str:
    lines = text.split("\n")
    at = _line(lines, rng)
    lines[at] = ("  " + lines[at]) if rng.random() < 0.5 else lines[at][int(rng.integers(1, 4)) :]
    return "\n".join(lines)


def _rename(text: str, other: str, rng: Generator) -> str:
    keys = list(KEY.finditer(text))
    if not keys:
        return text
    key, theirs = keys[int(rng.integers(len(keys)))], keys[int(rng.integers(len(keys)))].group()
    new = [theirs, KEYS[int(rng.integers(len(KEYS)))], key.group()[:-1], key.group().upper()][int(rng.integers(4))]
    return text[: key.start()] + new + text[key.end() :]


def _replace(text: str, other: str, rng: Generator) -> str:
    words = list(WORD.finditer(COMMENT.sub(lambda found: " " * len(found.group()), text)))
    if not words:
        return text
    at = words[int(rng.integers(len(words)))]
    old = at.group().strip()
    kind = rng.random()
    if kind < 0.6:
        new = ODD[int(rng.integers(len(ODD)))]
    elif kind < 0.8:
        new = words[int(rng.integers(len(words)))].group().strip()  # of another key: another type or unit
    elif kind < 0.9:
        new = f"[{old}]" if rng.random() < 0.5 else f"{{a: {old}}}"
    else:
        depth = int(rng.choice([20, 200, 5000]))
        new = "[" * depth + "]" * depth if rng.random() < 0.5 else "{a: " * depth + "1" + "}" * depth
    return text[: at.start()] + new + text[at.end() :]


def _scale(text: str, other: str, rng: Generator) -> str:
    numbers = list(NUMBER.finditer(COMMENT.sub(lambda found: " " * len(found.group()), text)))
    if not numbers:
        return text
    at = numbers[int(rng.integers(len(numbers)))]
    factor = float(rng.choice([-1.0, 0.0, 1e-6, 0.1, 0.9, 1.1, 2.0, 10.0, 1e6, 1e300]))
    return f"{text[: at.start()]}{factor * float(at.group()):g}{text[at.end() :]}"


def _anchor(text: str, other: str, rng: Generator) -> str:
    """Two values, or sections, of which the second is an alias of the first."""
    ends = list(re.finditer(r"(?<=:)(?= |$)", text, re.MULTILINE))
    if len(ends) < 2:
        return text
    i, j = sorted(int(k) for k in rng.choice(len(ends), 2, replace=False))
    first, second = ends[i].start(), ends[j].start()
    line = text.find("\n", second)
    rest = text[line if line >= 0 else len(text) :]
    return f"{text[:first]} &a{text[first:second]} *a{rest}"


MUTATIONS = (
    _drop,
    _duplicate,
    _splice,
    _indent,
    _rename,
    _rename,
    _replace,
    _replace,
    _replace,
    _scale,
    _scale,
    _anchor,
)


def mutated_files(
    numbers: Iterable[int], seed: int, machine: Callable = loading.load_machine, task: Callable = loading.load_task
) -> Tally:
    """Load mutated files.

    Args:
        numbers: Those of the cases.
        seed: Of all cases.
        machine: What loads a machine of a path.
        task: What loads a task.
    """
    tally = Tally()
    with tempfile.TemporaryDirectory() as folder:
        for number in numbers:
            rng = np.random.default_rng((seed, 0, number))
            kind = ("machine", "task")[number % 2]
            names = sorted(TEXTS[kind])
            text, other = (TEXTS[kind][str(rng.choice(names))] for _ in range(2))
            path = Path(folder) / f"{kind}.yaml"
            path.write_bytes(data := mutated(text, other, rng))
            with _watched(tally, f"file {number}", lambda data=data: repr(data.decode("utf-8", "replace"))):
                try:
                    _load_and_write(path, machine if kind == "machine" else task)
                finally:
                    tally.counts[f"{kind} files"] += 1
                tally.counts["loaded"] += 1
    return tally


def _load_and_write(path: Path, load: Callable) -> None:
    """Load a file; look at what loads as `check` does, write it and load it again."""
    began = time.process_time()
    try:
        found = load(path)
    finally:
        seconds = time.process_time() - began
        _require(seconds < SLOWEST, f"read in {seconds:.1f} s of processor time")
    checked = facts.check(str(path))
    json.dumps(checked.json(), allow_nan=False)
    shown = io.StringIO()
    machine_tables.checked(Console(file=shown, width=100), checked, False)
    if not _infinite(f"{found.name}\n{getattr(found, 'machine', found).name}"):  # names may be any words
        _require(not _infinite(shown.getvalue()), f"check prints {_infinite(shown.getvalue())}")
    copy = path.with_name("copy.yaml")
    is_task = hasattr(found, "path")
    if is_task:
        (path.parent / "copied-machine.yaml").write_text(loading.dump_machine(found.machine), encoding="utf-8")
    text = loading.dump_task(found, "copied-machine.yaml") if is_task else loading.dump_machine(found)
    copy.write_text(text, encoding="utf-8")
    try:
        again = load(copy)
    except lb.LeanboomError as error:
        raise _Wrong(f"what was written is refused: {error}") from None
    _require(again == found, "what was written loads as something else")


def _infinite(text: str) -> str:
    """A line of a text that has a number which is none, if there is one."""
    return next((line.strip() for line in text.splitlines() if re.search(r"(?<![\w])-?(nan|inf)(?![\w])", line)), "")


# Plans


def mutated_plans(numbers: Iterable[int], seed: int, tasks: Sequence[str] = tuple(TEXTS["task"].values())) -> Tally:
    """Plan tasks on machines whose numbers have changed.

    Args:
        numbers: Those of the cases.
        seed: Of all cases.
        tasks: Texts of the tasks that are drawn from.
    """
    tally = Tally()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "task.yaml"
        for number in numbers:
            rng = np.random.default_rng((seed, 1, number))
            with _watched(tally, f"plan {number}", lambda: path.with_name("machine.yaml").read_text(encoding="utf-8")):
                task = _drawn(path, tasks, rng)
                _plan(tally, task, ("ls", "cp")[number % 2], OTHERS[number // 2 % len(OTHERS)])
    return tally


def _drawn(path: Path, tasks: Sequence[str], rng: Generator) -> lb.Task:
    """A task on a machine with one to five numbers changed, of those that load."""
    while True:
        text = tasks[int(rng.integers(len(tasks)))]
        name = re.search(r"^machine: (\w+)", text, re.MULTILINE)
        machine = TEXTS["machine"][name.group(1) if name else "forwarder"]
        for _ in range(int(rng.integers(1, 6))):
            found = list(NUMBER.finditer(COMMENT.sub(lambda found: " " * len(found.group()), machine)))
            at = found[int(rng.integers(len(found)))]
            factor = float(np.exp(rng.uniform(*np.log(FACTORS))))
            machine = f"{machine[: at.start()]}{factor * float(at.group()):.6g}{machine[at.end() :]}"
        (path.parent / "machine.yaml").write_text(machine, encoding="utf-8")
        start = str(rng.choice(["smallest", "middle"]))
        path.write_text(re.sub("(?m)^machine: .*", "machine: machine.yaml", text), encoding="utf-8")
        try:
            return loading.load_task(path, start=start)
        except lb.InputError:
            continue


def _plan(tally: Tally, task: lb.Task, pump: str, other: str) -> None:
    """Plan a task by two methods and look at both."""
    plans = []
    for method in ("dp", other):
        tally.counts["plans"] += 1
        plan = planner.run(task, pump=pump, method=method, grid=GRID, step=STEP, baseline=False, check=False)
        json.dumps(summaries.summary(plan), allow_nan=False)
        told = "\n".join((plan.status, repr(plan), *plan.evaluation.notes, *plan.evaluation.violations))
        _require(len(told) < LONGEST and not _infinite(told), f"{method}, {pump}: {told[:LONGEST]}")
        if plan.solved:
            tally.counts["solved"] += 1
            again = lb.evaluate(task, plan.motion)
            _require(again.feasible, f"{method}, {pump}: solved, and when judged again: {again.status}")
            near = math.isclose(again.energy(pump), plan.evaluation.energy(pump), rel_tol=1e-9, abs_tol=1e-6)
            _require(near, f"{method}, {pump}: another energy when judged again")
        plans.append(plan)
    ours, theirs = plans
    if not theirs.evaluation.feasible:
        return
    # What a pump can deliver is told of a plan and is no limit of the search.
    _require(ours.evaluation.feasible, f"{pump}: {other} keeps all limits, dp does not: {ours.status}")
    energy, least = ours.evaluation.energy(pump), theirs.evaluation.energy(pump)
    if energy > least + AHEAD * max(abs(least), 1.0):  # by the coarse grid alone?
        energy = planner.run(task, pump=pump, baseline=False, check=False).evaluation.energy(pump)
    _require(energy <= least + AHEAD * max(abs(least), 1.0), f"{pump}: dp {energy:.2f} J, {other} {least:.2f} J")


# Kills


def killed_runs(numbers: Iterable[int], seed: int, method: str = "dp", task: str = "forwarder-vertical") -> Tally:
    """Stop runs at random instants: every second one while it writes its folder, if it comes to that.

    Args:
        numbers: Those of the runs.
        seed: Of all runs.
        method: That of the runs.
        task: What they plan.
    """
    tally = Tally()
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as elsewhere:
        out, earlier = Path(folder) / "run", Path(elsewhere) / "run"
        command = [sys.executable, "-m", "leanboom", "plan", task, "--method", method, "--out", str(out)]
        command += ["--grid", f"{GRID[0]}x{GRID[1]}", "--step", str(STEP)]
        began = time.perf_counter()
        _undisturbed(tally, command, out, "the first run")
        seconds = time.perf_counter() - began
        shutil.copytree(out, earlier)
        for number in numbers:
            rng = np.random.default_rng((seed, 2, number))
            sent = (signal.SIGKILL, signal.SIGINT)[number % 2]
            shutil.rmtree(out, ignore_errors=True)
            if rng.random() < 0.5:
                shutil.copytree(earlier, out)  # the run is to replace it
            said = _stopped(command, out, sent, float(rng.random()) * seconds, number // 2 % 2 == 1)
            tally.counts[f"runs sent {sent.name}"] += 1
            case = f"kill {number}, {sent.name}"
            if "Traceback" in said and f"{os.sep}leanboom{os.sep}" in said:  # not of Python's own start
                tally.finds.append(Find(case, "a traceback", said))
            if out.exists():
                tally.counts["folders complete"] += 1
                with _watched(tally, case, lambda: str(sorted(out.iterdir()))):
                    _complete(out)
            else:
                tally.counts["folders absent"] += 1
        _undisturbed(tally, command, out, "the last run")
        left = sorted(path.name for path in Path(folder).iterdir() if path != out)
        if left:
            tally.finds.append(Find("kills", f"left beside the folder after an undisturbed run: {', '.join(left)}"))
    return tally


def _complete(out: Path) -> None:
    """Raise what is wrong with a run folder."""
    try:
        run_folder.read(out)
    except lb.LeanboomError as error:
        raise _Wrong(str(error)) from None


def _undisturbed(tally: Tally, command: list[str], out: Path, case: str) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    with _watched(tally, case, lambda: done.stderr):
        _require(done.returncode == 0, f"ends with exit code {done.returncode}")
        _complete(out)


def _stopped(command: list[str], out: Path, sent: signal.Signals, after: float, writing: bool) -> str:
    """Start a run and stop it by a signal; what it says on standard error.

    Args:
        command: The run.
        out: Its folder.
        sent: The signal.
        after: When [s]; a thousandth of it after a new folder was begun beside the old one, if `writing`.
        writing: Whether to wait until the run writes its folder.
    """
    running = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    began, wait = time.perf_counter(), after
    while running.poll() is None and writing and not list(out.parent.glob(".*leanboom-new-*")):
        time.sleep(1e-3)
    if writing:
        began, wait = time.perf_counter(), 1e-3 * after
    while running.poll() is None and time.perf_counter() - began < wait:
        time.sleep(1e-3)
    running.send_signal(sent)  # nothing, if it has ended
    return running.communicate()[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=20_000)
    parser.add_argument("--plans", type=int, default=500)
    parser.add_argument("--kills", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it: runs would, too
    parts = (
        ("files", mutated_files, arguments.files, 1000),
        ("plans", mutated_plans, arguments.plans, 20),
        ("kills", killed_runs, arguments.kills, arguments.kills),
    )
    found = 0
    for name, part, cases, at_once in parts:
        total = Tally()
        for first in range(0, cases, max(1, at_once)):
            tally = part(range(first, min(cases, first + at_once)), arguments.seed)
            total.counts.update(tally.counts)
            total.finds += tally.finds
            for find in tally.finds:
                print(find, flush=True)
            print(f"{name}: {total}", flush=True)
        found += len(total.finds)
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()

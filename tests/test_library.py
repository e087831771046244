"""Motion libraries: specifications, builds, what may go wrong while they run, and what a store keeps."""

from __future__ import annotations

import errno
import json
import os
import signal
import sqlite3
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import fields, make_dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from command_line import leanboom
from leanboom import resources
from leanboom.errors import InfeasibleError, InputError, LeanboomError
from leanboom.io import loading
from leanboom.library import carrying, engine, keys, specification, warm_starts
from leanboom.library.lookup import Library, led_over
from leanboom.library.store import INDEX, SEGMENTS, Store
from leanboom.library.warm_starts import Known, Result
from leanboom.model import motion
from leanboom.model.task import Lines, Task

SPEC = """
machine: forwarder
origins: {type: points, points: [[4.3, 0, 2.5]]}
goals: {type: points, points: [[5.0, 0.5, 2.0], [5.5, 0, 2.0]]}
shape: {type: straight}
durations: [2 s, 3 s]
payloads: [0 kg, 100 kg]
starts: [0.5 m]
"""


@pytest.fixture
def made(tmp_path):
    return _specification(tmp_path, SPEC)


def _specification(folder, text, **settings):
    path = folder / "few.yaml"
    path.write_text(text)
    return specification.load(path, **settings)


def hold(sweep, near, *, marker=None, wait=0.0):
    """Stands for planning: an extension that does not move. The first to see no marker leaves one and dies."""
    time.sleep(wait)
    if marker is not None and not Path(marker).exists():
        Path(marker).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    found = []
    for task in sweep.tasks:
        count = round(task.duration / 0.05)
        still = motion.from_velocities(task.duration / count, 0.5, np.zeros(count + 1), "dp", sweep.pump)
        found.append(Result(0.5, None, True, "solved", 1000.0 * task.duration + task.payload, 1e4, 0.0, still))
    return tuple(found)


def lost(sweep, near):
    return tuple(Result(0.5, None, False, "joint lift is 0.2 rad beyond", None, None, 0.0, None) for _ in sweep.tasks)


class Threads:
    """Stands for processes."""

    def __init__(self, workers):
        self.slots, self.room, self._pool = 1, 2, ThreadPoolExecutor(1)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._pool.shutdown(cancel_futures=True)

    def submit(self, *call):
        return self._pool.submit(*call)


@pytest.fixture
def threads(monkeypatch):
    monkeypatch.setattr(engine, "_Processes", Threads)


def _whole(out, count=8):
    """A library in which every motion that the index names is there and right."""
    with Store(out) as held:
        assert not held.damaged()
        for entry in held.entries("segment NOTNULL"):
            assert held.motion(entry).duration == pytest.approx(entry.duration)
        return held.count() == count


def test_a_build_keeps_every_motion_and_the_next_one_uses_them_again(made, tmp_path, threads):
    first = engine.build(made, tmp_path / "out", work=hold)
    assert (first.total, first.solved, first.reused, first.failed) == (8, 8, 0, 0)
    assert list(first.json()) == ["total", "solved", "infeasible", "reused", "failed", "build_s"]
    again = engine.build(made, tmp_path / "out", work=partial(hold, marker="/"))
    assert (again.solved, again.reused) == (8, 8)
    assert _whole(tmp_path / "out")
    assert len(list((tmp_path / "out" / SEGMENTS).iterdir())) == 1  # small files are put together


def test_an_extended_specification_plans_what_is_new_alone(made, tmp_path, threads):
    engine.build(made, tmp_path / "out", work=hold)
    more = _specification(tmp_path, SPEC.replace("[2 s, 3 s]", "[2 s, 3 s, 4 s]"))
    assert engine.build(more, tmp_path / "out", work=hold).reused == 8
    assert _whole(tmp_path / "out", 12)


def test_motions_of_a_later_search_take_the_place_of_earlier_ones(made, tmp_path, threads, monkeypatch):
    engine.build(made, tmp_path / "out", work=hold)
    monkeypatch.setattr(keys, "METHOD", "another search")
    again = engine.build(made, tmp_path / "out", work=hold)
    assert (again.solved, again.reused) == (8, 0)
    assert _whole(tmp_path / "out")
    index = sqlite3.connect(tmp_path / "out" / INDEX)
    assert index.execute("SELECT count(*) FROM velocities").fetchone() == (8,)
    index.close()


def test_keys_of_motions_stay_what_they_were_where_a_task_uses_nothing_new():
    """A library built before tasks could limit the pump's flow keeps its motions."""
    task = loading.load_task("forwarder-vertical")
    key = keys.motion_key(task, "ls", "machine")
    assert key == "327c5f12806ddf3fcae2c93b702f6570"
    assert keys.motion_key(loading.load_task("forwarder-vertical", pump_flow_limit=True), "ls", "machine") != key
    assert keys.motion_key(replace(task, timing="free"), "ls", "machine") != key
    more = make_dataclass("Task", [("hurry", float, 1.0)], bases=(Task,), frozen=True)
    plain = {each.name: getattr(task, each.name) for each in fields(task)}
    assert keys.motion_key(more(**plain), "ls", "machine") == key
    assert keys.motion_key(more(**plain, hurry=2.0), "ls", "machine") != key


def test_what_has_no_solution_is_kept_with_its_reason(made, tmp_path, threads):
    summary = engine.build(made, tmp_path / "out", work=lost)
    assert (summary.infeasible, summary.solved) == (8, 0)
    assert list(summary.reasons.values()) == [8]
    assert engine.build(made, tmp_path / "out", work=hold).reused == 8
    with Library(tmp_path / "out") as library, pytest.raises(InfeasibleError, match="joint lift"):
        library.query((4.3, 0, 2.5), (5, 0.5, 2))


def test_a_changed_number_invalidates_what_depends_on_it_alone():
    machine = loading.load_machine("forwarder")
    before = keys.machine_keys(machine)

    def changed(**values):
        after = keys.machine_keys(replace(machine, **values))
        return {key for key in before if after[key] != before[key]}

    def pump(**values):
        return changed(pump=replace(machine.pump, **values))

    assert pump(constant_pressure=0.9 * machine.pump.constant_pressure) == {("cp", False), ("cp", True)}
    assert pump(ls_margin=0.9 * machine.pump.ls_margin) == {("ls", False), ("ls", True)}
    assert changed(payload_along=machine.payload_along + 0.1) == {("ls", True), ("cp", True)}
    assert changed(description="other", provenance=(), name="other") == set()
    assert changed(gravity=9.0) == set(before)


def test_motions_of_another_value_are_planned_again_and_no_others(made, tmp_path, threads):
    engine.build(made, tmp_path / "out", work=hold)
    other = replace(made, machine=replace(made.machine, payload_along=made.machine.payload_along + 0.1))
    assert engine.build(other, tmp_path / "out", work=hold).reused == 4  # those without a payload
    with Store(tmp_path / "out") as held:
        assert held.count() == 8


def slowly(spec, out, pipe):
    """A build of another process that says how far it is."""
    made = specification.load(spec)
    tell = lambda text, share: pipe.send(text)  # noqa: E731
    engine.build(made, out, workers=1, work=partial(hold, wait=0.05), progress=tell)


@pytest.mark.slow
def test_a_build_that_is_killed_loses_nothing_that_it_reported(made, tmp_path, rng, threads):
    """Whatever moment it is killed at, the next one goes on."""
    out, context = tmp_path / "out", resources.process_context([engine.__name__])
    here, there = context.Pipe(duplex=False)
    running = context.Process(target=slowly, args=(tmp_path / "few.yaml", out, there))
    running.start()
    there.close()
    while "of 8 motions" not in (line := here.recv()):
        pass
    time.sleep(rng.uniform(0.0, 0.15))
    running.kill()
    running.join()
    number = int(line.split()[0])
    with suppress(EOFError):
        while True:
            number = int(here.recv().split()[0])
    with Store(out) as held:
        assert held.count() >= number > 0
    _whole(out)
    assert engine.build(made, out, work=hold).reused >= number
    assert _whole(out)


def test_a_worker_that_is_killed_costs_no_motion(made, tmp_path):
    summary = engine.build(made, tmp_path / "out", workers=2, work=partial(hold, marker=str(tmp_path / "died")))
    assert (tmp_path / "died").exists()
    assert (summary.solved, summary.failed) == (8, 0)
    assert _whole(tmp_path / "out")


def deadly(sweep, near):
    """Kills its worker for all but one goal, whose sweeps are at work while that happens again and again."""
    if sweep.tasks[0].path.points[1][0] != 5.0:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.5)
    return hold(sweep, near)


def test_a_worker_that_dies_costs_the_sweep_it_was_at_and_no_other(made, tmp_path):
    """All workers shared one pool: the end of one was counted against the sweeps of all."""
    summary = engine.build(made, tmp_path / "out", workers=2, work=deadly)
    assert (summary.solved, summary.failed) == (4, 4)
    assert summary.reasons == {"its worker died 3 times": 4}


def test_what_fails_in_every_worker_is_counted_and_tried_again(made, tmp_path):
    dies = partial(hold, marker=str(tmp_path / "no" / "where"))  # cannot leave its marker: an error each time
    summary = engine.build(made, tmp_path / "out", workers=1, work=dies)
    assert (summary.failed, summary.solved) == (8, 0)
    assert "FileNotFoundError" in next(iter(summary.reasons))
    assert engine.build(made, tmp_path / "out", workers=1, work=hold).solved == 8


def test_a_full_disk_keeps_what_was_written(made, tmp_path, threads, monkeypatch):
    from pyarrow import parquet

    write, left = parquet.write_table, [2]

    def full(*arguments, **settings):
        if not left[0]:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        left[0] -= 1
        write(*arguments, **settings)

    monkeypatch.setattr(parquet, "write_table", full)
    with pytest.raises(InputError, match="No space left"):
        engine.build(made, tmp_path / "out", work=hold)
    monkeypatch.undo()
    monkeypatch.setattr(engine, "_Processes", Threads)
    with Store(tmp_path / "out") as held:
        assert held.count() == 2
    assert engine.build(made, tmp_path / "out", work=hold).reused == 2
    assert _whole(tmp_path / "out")


def test_two_builds_do_not_write_at_once(made, tmp_path, threads):
    def second(sweep, near):
        with pytest.raises(InputError, match="another run of leanboom writes there"):
            engine.build(made, tmp_path / "out", work=hold)
        return hold(sweep, near)

    assert engine.build(made, tmp_path / "out", work=second).solved == 8


def test_a_truncated_file_is_never_read_and_the_next_build_writes_it_again(made, tmp_path, threads):
    """Nothing is planned for that: the index holds its motions too."""
    from pyarrow import parquet

    engine.build(made, tmp_path / "out", work=hold)
    (file,) = (tmp_path / "out" / SEGMENTS).iterdir()
    content, rows = file.read_bytes(), parquet.read_table(file)
    for broken in (content[: len(content) // 2], content[:-1], b""):
        file.write_bytes(broken)
        with Library(tmp_path / "out") as library:
            assert library.query((4.3, 0, 2.5), (5, 0.5, 2)).motion.duration == 2.0
            assert carrying.verify(library).damaged
        assert leanboom("library", "verify", str(tmp_path / "out")).exit_code == 2
        assert engine.build(made, tmp_path / "out", work=partial(hold, marker="/no/where")).reused == 8
        assert _whole(tmp_path / "out")
        (file,) = (tmp_path / "out" / SEGMENTS).iterdir()
        assert parquet.read_table(file).equals(rows)


def test_a_reader_is_not_disturbed_by_files_put_together_meanwhile(made, tmp_path, threads, monkeypatch):
    """It read an entry, then a file that was gone."""
    monkeypatch.setattr(Store, "compact", lambda store: None)
    engine.build(made, tmp_path / "out", work=hold)
    monkeypatch.undo()
    with Store(tmp_path / "out") as reader, Store(tmp_path / "out", write=True) as writer:
        entries = reader.entries()
        writer.compact()
        assert len({each.segment for each in entries}) == 8
        assert len({each.segment for each in reader.entries()}) == 1
        assert [reader.motion(each).duration for each in entries] == [each.duration for each in entries]


def _aged(out):
    """Lead an index back to its first format."""
    old = sqlite3.connect(out / INDEX)
    old.executescript(
        "DROP TABLE near; DROP INDEX motions_of_way; DROP INDEX motions_of_segment; DROP TABLE velocities; "
        "ALTER TABLE motions DROP COLUMN end_m; PRAGMA user_version = 1"
    )
    old.close()


def test_an_older_format_is_renewed_by_a_build_and_a_newer_one_refused(made, tmp_path, threads):
    out = tmp_path / "out"
    engine.build(made, out, work=hold)
    _aged(out)
    with pytest.raises(InputError, match="older format 1: build it again"):
        Store(out)
    assert engine.build(made, out, work=hold).reused == 8
    with Library(out) as library:
        assert library.query((4.3, 0, 2.5), (5, 0.5, 2)).stored
    assert _whole(out)
    _aged(out)
    (file,) = (out / SEGMENTS).iterdir()
    file.write_bytes(file.read_bytes()[:-1])
    assert engine.build(made, out, work=hold).reused == 0  # its motions were in the damaged file alone
    assert _whole(out)
    new = sqlite3.connect(out / INDEX)
    new.execute("PRAGMA user_version = 99")
    new.close()
    with pytest.raises(InputError, match="has format 99, this leanboom reads up to 3"):
        engine.build(made, out, work=hold)


def test_a_library_of_another_machine_is_refused(made, tmp_path, threads):
    engine.build(made, tmp_path / "out", work=hold)
    text = SPEC.replace("forwarder", "loader").replace("[[4.3, 0, 2.5]]", "[[2, 0, 1]]")
    other = _specification(tmp_path, text.replace("[5.0, 0.5, 2.0], [5.5, 0, 2.0]", "[2.5, 0, 1.5]"))
    with pytest.raises(InputError, match="is a library of machine forwarder, not loader"):
        engine.build(other, tmp_path / "out", work=hold)
    with pytest.raises(InputError, match="holds motions of machine forwarder, asked for is machine loader"):
        Library(tmp_path / "out", loading.load_machine("loader"))
    Library(tmp_path / "out", made.machine).close()


def test_a_folder_of_something_else_is_left_alone(made, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").touch()
    with pytest.raises(InputError, match="holds no library"):
        engine.build(made, tmp_path / "mine", work=hold)
    with pytest.raises(InputError, match="make a library"):
        Library(tmp_path / "mine")


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (("[2 s, 3 s]", "[0 s]"), r"few.yaml:6: durations\[0\] = 0 s; must be"),
        (("[5.5, 0, 2.0]", "[25, 0, 2]"), r"few.yaml:4: goals.points\[1\] = .*must be a place that the crane reaches"),
        (("starts: [0.5 m]", "starts: [9 m]"), "the stroke of the extension cylinder"),
        (("starts: [0.5 m]", "end: 9 m"), r"few.yaml:8: end = 9 m; must be from 0 to .* the stroke of the extension"),
        (("starts: [0.5 m]", "end: best"), "end = best; must be free, same, smallest, middle, or a length"),
        (("straight", "round"), "must be straight, arch"),
        (("payloads", "payload"), "payload is not a key here"),
        (("[[5.0, 0.5, 2.0], [5.5, 0, 2.0]]", "[[4.3, 0, 2.5]]"), "hold no two places apart"),
    ],
)
def test_a_wrong_specification_is_refused_with_what_to_change(tmp_path, wrong, said):
    with pytest.raises(InputError, match=said):
        _specification(tmp_path, SPEC.replace(*wrong))


def test_a_million_motions_by_mistake_are_refused_before_anything_begins(tmp_path):
    many = ", ".join(f"{0.001 * k:.3f}" for k in range(1000))
    grid = f"goals: {{type: grid, x: [{many}], y: [{many}], z: [1]}}"
    text = SPEC.replace("goals: {type: points, points: [[5.0, 0.5, 2.0], [5.5, 0, 2.0]]}", grid)
    with pytest.raises(InputError, match=r"4,000,000 motions, about 58 days with 2 at a time, more than 20,000"):
        _specification(tmp_path, text, workers=2)


@pytest.mark.parametrize("name", loading.bundled_libraries())
def test_bundled_specifications_load(name):
    made = specification.load(name)
    assert made.total == sum(len(sweep.tasks) for family in made.families() for sweep in family.sweeps)
    assert name != "forwarder-small" or made.total <= 24


def test_pyarrow_that_is_missing_is_named(made, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(LeanboomError, match=r"pip install 'leanboom\[library\]'"):
        engine.build(made, tmp_path / "out", work=hold)


def test_the_nearest_way_and_the_least_energy_that_fits_are_found(made, tmp_path, threads):
    engine.build(made, tmp_path / "out", work=hold)
    with Library(tmp_path / "out") as library:
        ask = partial(library.query, (4.3, 0, 2.5), (5, 0.5, 2))
        assert ask().entry.duration == 2.0
        assert ask(payload=50.0).entry.payload == 100.0
        assert library.query((4.3, 0, 2.5), (5.3, 0.1, 2)).entry.goal == (5.5, 0.0, 2.0)
        assert not library.query((4.3, 0, 2.5), (9.0, 0.1, 2)).stored
        for settings, said in (
            ({"max_duration": 1.0}, "quickest stored motion there takes 2 s"),
            ({"payload": 500.0}, "up to 100 kg"),
            ({"pump": "cp"}, "with pump cp"),
        ):
            with pytest.raises(InfeasibleError, match=said):
                ask(**settings)
        with pytest.raises(InputError, match="must be three numbers"):
            library.query((1, 2), (5, 0.5, 2))


def test_a_motion_is_led_over_from_the_actual_extension(made, tmp_path, threads):
    engine.build(made, tmp_path / "out", work=hold)
    with Library(tmp_path / "out") as library:
        answer = library.query((4.3, 0, 2.5), (5, 0.5, 2), extension=0.6)
    assert answer.motion.position[0] == 0.6
    assert answer.motion.position[-1] == pytest.approx(0.5, abs=1e-12)
    assert answer.motion.velocity[[0, -1]] == pytest.approx(0.0)
    assert answer.blended_m == pytest.approx(0.1)
    assert led_over(answer.motion, 0.6) is answer.motion


def test_a_store_reads_back_the_same_bits(made, tmp_path, threads, rng):
    velocity = rng.normal(size=41)
    moving = motion.from_velocities(0.05, 0.3, velocity, "dp", "ls")
    engine.build(made, tmp_path / "out", work=hold)
    with Store(tmp_path / "out", write=True) as held:
        entry = held.entries()[0]
        held.add([(entry, moving)])
        (entry,) = held.entries("key = ?", (entry.key,))
        again = held.motion(entry)
    assert np.array_equal(again.velocity, moving.velocity)
    assert np.array_equal(again.position, moving.position)


def test_motions_end_where_a_specification_says(tmp_path, threads):
    """The first by the whole search, the next from its neighbour; both come back to where they began."""
    few = SPEC.replace(", [5.5, 0, 2.0]", "").replace("[0 kg, 100 kg]", "[0 kg]").replace("[2 s, 3 s]", "[3 s]")
    text = few.replace("starts: [0.5 m]", "starts: [0.4 m, 0.5 m]\npumps: [cp]\nend: same")
    engine.build(_specification(tmp_path, text), tmp_path / "out")
    with Library(tmp_path / "out") as library:
        for entry in library.store.entries():
            moved = library.store.motion(entry)
            assert moved.position[-1] == pytest.approx(float(entry.start), abs=1e-6)
            assert entry.end_m == pytest.approx(float(entry.start), abs=1e-6)
        answer = library.query((4.3, 0, 2.5), (5, 0.5, 2), pump="cp", extension=0.52)
        assert library.judged(answer).status_with("cp").solved  # led over, it ends where the stored one does
    free = _specification(tmp_path, text.replace("same", "free"))
    with pytest.raises(InputError, match="of motions with end same, not free: give another folder"):
        engine.build(free, tmp_path / "out")


def test_neighbours_lead_to_the_motion_of_the_whole_search():
    """Carried over from a slower motion with another start, the answer is within 0.2 % of a fresh plan."""
    machine = loading.load_machine("forwarder")

    def task(duration, start):
        return Task("t", machine, Lines(((4.3, 0, 2.5), (5.5, 0, 2.0)), (duration,)), 0.0, start)

    def planned(asked, near):
        (found,) = warm_starts.plan_sweep(specification.Sweep((asked,), "cp"), near)
        return found

    slow, asked = task(4.0, "smallest"), task(3.0, "middle")
    warm = planned(asked, (Known(slow, planned(slow, ()).motion),))
    fresh = planned(asked, ())
    assert warm.solved
    assert warm.energy_j == pytest.approx(fresh.energy_j, rel=2e-3)
    assert warm.pseudo_inverse_j > warm.energy_j


def test_the_command_builds_queries_verifies_and_exports(tmp_path):
    """The whole way on two short motions."""
    short = SPEC.replace(", [5.5, 0, 2.0]", "").replace("[0 kg, 100 kg]", "[0 kg]") + "pumps: [cp]\n"
    (tmp_path / "few.yaml").write_text(short)
    out = str(tmp_path / "out")
    built = leanboom("library", "build", str(tmp_path / "few.yaml"), "--out", out, "--workers", "2", "--json")
    assert built.exit_code == 0, built.output
    numbers = json.loads(built.stdout)
    assert (numbers["total"], numbers["solved"], numbers["failed"]) == (2, 2, 0)
    assert "2 motions, about" in built.stderr
    ask = ("library", "query", out, "--from", "4.3,0,2.5", "--pump", "cp", "--json")
    answer = json.loads(leanboom(*ask, "--to", "5,0.5,2", "--extension", "0.5 m").stdout)
    assert (answer["polished"], answer["status"], len(answer["movement"])) == (False, "solved", 2)
    near = json.loads(leanboom(*ask, "--to", "5.05,0.5,2").stdout)
    assert near["polished"]
    assert abs(near["more_than_fresh"]) < 0.02
    assert json.loads(leanboom("library", "verify", out, "--json").stdout) == {
        "checked": 2, "wrong": [], "damaged_files": []
    }  # fmt: skip
    assert json.loads(leanboom("library", "info", out, "--json").stdout)["solved"] == 2
    for name, lines in (("all.csv", 1 + 41 + 61), ("all.parquet", None)):
        assert leanboom("library", "export", out, "--out", str(tmp_path / name)).exit_code == 0
        assert lines is None or len((tmp_path / name).read_text().splitlines()) >= lines
    assert "What one hour of work takes" in (tmp_path / "out" / "report.html").read_text()
    bad = leanboom("library", "query", out, "--from", "4.3", "--to", "5,0.5,2")
    assert (bad.exit_code, "must be three lengths" in bad.stderr) == (2, True)


@pytest.mark.slow
def test_a_dask_cluster_builds_the_same_library(made, tmp_path):
    summary = engine.build(made, tmp_path / "out", workers=1, cluster="local", work=hold)
    assert (summary.solved, summary.failed) == (8, 0)
    assert _whole(tmp_path / "out")

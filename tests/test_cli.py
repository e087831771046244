"""The command line as a whole and its lists and checks: streams, exit codes, help, completion, interrupts."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from command_line import leanboom, words
from leanboom.cli import app, terminal
from leanboom.components import costs
from leanboom.io import loading
from leanboom.methods.registry import METHODS
from leanboom.planning import planner
from leanboom.report import facts


def test_help_names_every_command_method_and_cost():
    assert all(name in leanboom("--help").stdout for name in ("plan", "check", "machines", "tasks"))
    text = words(leanboom("plan", "--help").stdout)
    listed = {
        option: re.split(r"[,.]? ", part[1])
        for option, part in {
            "methods": re.search(r"dp \(the planner\), (.*?)\. \[", text),
            "costs": re.search(r"if not the pump's energy: (.*?)\. ", text),
        }.items()
        if part
    }
    assert {"dp", *listed["methods"]} == set(METHODS.names())
    assert set(listed["costs"]) == set(costs.COSTS)


def test_version():
    result = leanboom("--version")
    assert result.exit_code == 0
    assert re.fullmatch(r"leanboom \d+\.\d+\.\d+\n", result.stdout)


def test_the_module_runs_as_the_command_does():
    answer = subprocess.run([sys.executable, "-m", "leanboom", "--version"], capture_output=True, text=True, check=True)
    assert answer.stdout == leanboom("--version").stdout


@pytest.mark.parametrize("command", ["", *(command.callback.__name__ for command in app.app.registered_commands)])
def test_help_fits_80_columns_and_names_arguments_plainly(command):
    result = CliRunner().invoke(app.app, [*command.split(), "--help"], env={"COLUMNS": "80", "TERM": "dumb"})
    assert result.exit_code == 0
    assert max(map(len, result.stdout.splitlines())) <= 80
    usage = next(line for line in result.stdout.splitlines() if "Usage:" in line)
    assert not re.search(r"\[\[|\.\.\.[}\]]", usage), usage
    assert "…" not in result.stdout


@pytest.mark.parametrize(
    ("line", "names"),
    [
        ("leanboom plan forwarder-v", ["forwarder-vertical"]),
        ("leanboom check loader", [name for name in ("loader", *loading.bundled_tasks()) if name.startswith("loader")]),
        ("leanboom machines ", ["forwarder", "loader"]),
        ("leanboom plan --pu", ["--pump", "--pump-flow-limit"]),
        ("leanboom cert", ["certify"]),
    ],
)
def test_the_shell_completes_commands_options_and_bundled_names(line, names):
    words = line.split(" ")
    answer = CliRunner().invoke(
        app.app,
        prog_name="leanboom",
        env={"_LEANBOOM_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(len(words) - 1)},
    )
    assert answer.stdout.split() == names


def test_completion_for_a_home_that_cannot_be_written_is_refused(monkeypatch, tmp_path, capsys):
    home = tmp_path / "file"
    home.write_text("", encoding="utf-8")
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setattr(sys, "argv", ["leanboom", "--install-completion", "bash"])
    monkeypatch.setenv("_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION", "1")
    with pytest.raises(SystemExit) as end:
        app.main()
    assert end.value.code == 2
    assert "cannot be written" in capsys.readouterr().err


def test_help_starts_without_heavy_imports():
    program = (
        "import sys; from leanboom.cli import app as cli; sys.argv = ['leanboom', 'plan', '--help']\n"
        "try: cli.main()\n"
        "except SystemExit as end: assert end.code == 0\n"
        "print(sorted({'numba', 'plotly', 'numpy', 'scipy', 'casadi', 'pint', 'jinja2', 'psutil'} & set(sys.modules)))"
    )
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert answer.stdout.splitlines()[-1] == "[]"


def test_usage_errors_exit_with_2():
    assert leanboom("plan", "forwarder-vertical", "--pump", "electric").exit_code == 2
    assert leanboom("plan").exit_code == 2
    assert leanboom("fly").exit_code == 2


def test_check_counts_where_values_come_from():
    result = leanboom("check", "forwarder")
    text = words(result.stdout)
    assert result.exit_code == 0
    assert "forwarder: machine forwarder is right." in text
    assert "printed 52 derived 9 identified 0 assumed 61 unstated 0" in text
    assert "cylinders.tilt.linkage.L22 0.181 m proportions of two comparable cranes" in text


def test_check_reads_tasks_and_files(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(loading.dump_task(loading.load_task("loader-triangle-small"), "loader"), encoding="utf-8")
    result = leanboom("check", str(file), "forwarder-vertical")
    assert result.exit_code == 0
    assert "task loader-triangle-small is right" in result.stdout
    assert "forwarder-vertical: task forwarder-vertical is right" in result.stdout


def test_check_tells_of_a_slow_path_how_fast_it_is(tmp_path):
    """A tool that moves at less than 5 mm/s read "at most 0.00 m/s"."""
    file = tmp_path / "slow.yaml"
    text = loading.dump_task(loading.load_task("forwarder-vertical"), "forwarder")
    assert "durations: [6 s]" in text
    file.write_text(text.replace("[6 s]", "[3600 s]"), encoding="utf-8")
    assert re.search(r"in 3600 s, at most 0\.00[0-9]*[1-9] m/s", leanboom("check", str(file)).stdout)


def test_check_reports_every_problem_of_every_file(tmp_path):
    machine, task = tmp_path / "machine.yaml", tmp_path / "task.yaml"
    text = loading.dump_machine(loading.load_machine("loader")).replace("bore: 80 mm", "bore: -80 mm")
    machine.write_text(text, encoding="utf-8")
    task.write_text("machine: nope\npath: {}\n", encoding="utf-8")
    result = leanboom("check", str(machine), "loader", str(task), "missing")
    assert result.exit_code == 2
    assert result.stderr.count("bore = -80 mm; must be above 0") == 2
    assert f"{task}:1: machine = nope" in result.stderr
    assert (
        "missing: is no file and no bundled name; machines: forwarder, loader; tasks: forwarder-cycle" in result.stderr
    )
    assert "machine loader is right" in result.stdout


def test_check_says_when_a_path_cannot_be_reached(tmp_path):
    file = tmp_path / "far.yaml"
    text = loading.dump_task(loading.load_task("forwarder-horizontal"), "forwarder")
    file.write_text(text.replace("[7.2, 0, 2]", "[12, 0, 2]"), encoding="utf-8")
    result = leanboom("check", str(file))
    assert result.exit_code == 1
    assert result.stderr.startswith(f"leanboom: {file}: no extension reaches the path")


def test_check_tells_of_a_machine_once_however_many_tasks_it_has():
    result = leanboom("check", "forwarder-vertical", "loader", "forwarder-horizontal", "forwarder")
    assert result.exit_code == 0
    assert result.stdout.count("Held at reach") == 2
    assert result.stdout.count("Machine           forwarder, as above") == 2
    assert result.stdout.count("61\nunstated") == 1


def test_check_prints_json_and_nothing_else(tmp_path):
    machine, task, far = tmp_path / "machine.yaml", tmp_path / "task.yaml", tmp_path / "far.yaml"
    text = loading.dump_machine(loading.load_machine("loader")).replace("bore: 80 mm", "bore: 10 in", 1)
    machine.write_text(text, encoding="utf-8")
    path = loading.dump_task(loading.load_task("forwarder-horizontal"), "forwarder")
    far.write_text(path.replace("[7.2, 0, 2]", "[12, 0, 2]"), encoding="utf-8")
    task.write_text(path.replace("machine: forwarder", "machine: machine.yaml").replace("start: ", "star: "))
    result = leanboom("check", "loader-triangle-small", str(task), str(far), "missing", "--json")
    assert result.exit_code == 2
    good, wrong, unreached, missing = json.loads(result.stdout)
    assert good == {
        "file": "loader-triangle-small",
        "kind": "task",
        "name": "loader-triangle-small",
        "machine": "loader",
        "values": facts.count(loading.load_machine("loader")),
        "problems": [],
        "notes": [],
    }
    assert (wrong["file"], wrong["kind"], wrong["name"], wrong["values"]) == (str(task), "task", None, None)
    assert {problem["key"] for problem in wrong["problems"]} == {"star", "start", "cylinders.lift.bore"}
    unknown, absent, bore = (
        next(problem for problem in wrong["problems"] if problem["key"] == key)
        for key in ("star", "start", "cylinders.lift.bore")
    )
    line = 1 + next(i for i, row in enumerate(text.splitlines()) if "bore: 10 in" in row)
    assert bore == {
        "file": str(machine),
        "line": line,
        "key": "cylinders.lift.bore",
        "value": "10 in",
        "allowed": "must be a finite length in mm, cm, m, such as 610 mm; in is not a unit here",
        "text": "cylinders.lift.bore = 10 in; must be a finite length in mm, cm, m, such as 610 mm; in is not a unit "
        "here",
    }
    assert unknown["allowed"].endswith("did you mean start?") and absent["value"] is None
    assert "no extension reaches" in unreached["problems"][0]["text"] and unreached["machine"] == "forwarder"
    assert missing["kind"] is None and missing["problems"][0]["text"].startswith("is no file and no bundled name")


@pytest.mark.parametrize("machine", ["loader", "forwarder"])
def test_what_check_doubts_are_the_notes_of_its_json(tmp_path, machine):
    file = tmp_path / "weak.yaml"
    text = re.sub(
        "(max_pressure|constant_pressure): [0-9.]+ MPa",
        r"\1: 6 MPa",
        loading.dump_machine(loading.load_machine(machine)),
    )
    file.write_text(text, encoding="utf-8")
    (found,) = json.loads(leanboom("check", str(file), "--json").stdout)
    assert found["problems"] == []
    assert found["notes"] == list(facts.doubts(loading.load_machine(file)))
    assert ("holding the empty crane" in " ".join(found["notes"])) == (machine == "forwarder")


def test_reach_and_static_pressures_are_plausible():
    reach = facts.reach(loading.load_machine("forwarder"))
    assert reach.radius == pytest.approx(9.1, abs=0.01)  # printed: "reach 9.1 m"
    assert reach.pressure[0] == 0.0
    assert all(1e6 < pressure < 21.5e6 for pressure in reach.pressure[1:])
    assert facts.doubts(loading.load_machine("forwarder")) == ()


@pytest.mark.parametrize("kind", ["machines", "tasks"])
def test_lists_name_every_bundled_one(kind):
    names = list(loading.bundled_machines() if kind == "machines" else loading.bundled_tasks())
    text = leanboom(kind).stdout
    assert all(name in text for name in names)
    assert [entry["name"] for entry in json.loads(leanboom(kind, "--json").stdout)] == names
    one = json.loads(leanboom(kind, names[0], "--json").stdout)
    assert one["name"] == names[0]
    assert names[0] in leanboom(kind, names[0]).stdout


def test_unknown_names_list_the_valid_ones():
    result = leanboom("machines", "forwader")
    assert result.exit_code == 2
    assert "forwarder, loader; did you mean forwarder?" in result.stderr


def test_control_characters_of_file_names_are_not_printed():
    result = leanboom("check", "\x1b[31mred")
    assert result.exit_code == 2
    assert "\x1b" not in result.stderr


INTERRUPTED_START = """
import os, signal, sys

left = int(sys.argv[1])


class Finder:
    def find_spec(self, *_):
        global left
        left -= 1
        if left == 0:
            os.kill(os.getpid(), signal.SIGINT)


signal.signal(signal.SIGINT, signal.default_int_handler)  # whoever runs the tests may ignore it

import leanboom.__main__ as beginning

sys.meta_path.insert(0, Finder())
sys.argv = ["leanboom", "tasks"]
beginning.main()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX systems")
@pytest.mark.parametrize("left", [1, 150, 400])
def test_ctrl_c_while_modules_load_ends_with_a_word(left):
    """It ended in a traceback of whatever was imported at the moment."""
    answer = subprocess.run(
        [sys.executable, "-c", INTERRUPTED_START, str(left)], capture_output=True, text=True, check=False
    )
    assert (answer.returncode, answer.stdout, answer.stderr) == (130, "", "leanboom: interrupted\n")


def test_ctrl_c_during_work_is_an_exception_and_work_can_be_tidied_up():
    def leave(*_):
        raise AssertionError

    before = signal.signal(signal.SIGINT, leave)
    try:
        with terminal.Progress():
            assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        assert signal.getsignal(signal.SIGINT) is leave
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        with terminal.Progress():
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX systems")
def test_a_request_to_end_is_minded_as_ctrl_c_is(monkeypatch, tmp_path):
    """It killed the process on the spot and left hidden folders and workers behind."""
    monkeypatch.setattr(planner, "run", lambda *_, **__: os.kill(os.getpid(), signal.SIGTERM))
    result = leanboom("plan", "forwarder-vertical", "--out", str(tmp_path / "plan"))
    assert (result.exit_code, result.stderr) == (143, "leanboom: ended on request\n")
    assert list(tmp_path.iterdir()) == []
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


@pytest.mark.parametrize(
    ("target", "arguments"),
    [
        ("a full disk", "tasks"),
        ("a full disk", "--help"),
        ("a closed pipe", "tasks"),
        ("a closed pipe", "tasks --json"),
    ],
)
def test_results_that_cannot_be_written_end_with_a_message(target, arguments):
    """Both ended in a traceback, of the command or of Python's own end."""
    if target == "a full disk":
        if not Path("/dev/full").exists():
            pytest.skip("this system has no device that is always full")
        stream = Path("/dev/full").open("wb")
    else:
        read, write = os.pipe()
        os.close(read)
        stream = os.fdopen(write, "wb")
    with stream:
        answer = subprocess.run(
            [sys.executable, "-m", "leanboom", *arguments.split()],
            stdout=stream,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert answer.returncode == 2
    reason = "No space left on device" if target == "a full disk" else "Broken pipe"
    assert answer.stderr == f"leanboom: standard output: cannot be written: {reason}\n"

"""Timing: how fast a path is followed, given or planned."""

from __future__ import annotations

from dataclasses import replace

import pytest

from leanboom.errors import InputError
from leanboom.io.loading import dump_task, load_task
from leanboom.model.task import Retimed


def test_a_retimed_path_is_written_and_read_again(tmp_path):
    """What a plan of a free timing is kept as."""
    task = replace(load_task("loader-triangle-small"), source="")
    task = replace(task, path=Retimed(task.path, (0.1, 1.0 / 3.0, 0.0, 2.0)))
    file = tmp_path / "again.yaml"
    file.write_text(dump_task(task, "loader"), encoding="utf-8")
    assert replace(load_task(file), source="") == replace(task, name="loader-triangle-small")


TIMINGS = [
    ("duration: 12 s", 12.0, "fixed", None),
    ("duration: shortest", 30.0, "shortest", None),
    ("timing: shortest", 30.0, "shortest", None),
    ("timing: free\nduration: 12 s", 12.0, "free", None),
    ("duration: long", 0.0, "", ":15: duration = long; must be shortest, or a time from 0.0001 s to 3600 s"),
    ("duration: -3 s", 0.0, "", ":15: duration = -3 s; must be shortest, or a time from 0.0001 s to 3600 s"),
    (
        "duration: [6 s, 4 s]",
        0.0,
        "",
        ":15: duration = [6 s, 4 s]; must be shortest, or a time from 0.0001 s to 3600 s",
    ),
    ("timing: fre", 0.0, "", ":15: timing = fre; must be fixed, free, shortest; did you mean free?"),
    ("timing: shortest\nduration: 5 s", 0.0, "", ":16: duration = 5 s; must be left out with timing: shortest"),
    ("duration: shortest\ntiming: free", 0.0, "", ":16: timing = free; must be left out with duration: shortest"),
    ("duration: shortest\nsmooth: 5 Hz", 0.0, "", ":16: smooth = 5 Hz; must be left out with timing: shortest"),
]


@pytest.mark.parametrize(("text", "duration", "timing", "message"), TIMINGS)
def test_a_task_says_how_long_its_path_takes(tmp_path, text, duration, timing, message):
    file = tmp_path / "task.yaml"
    file.write_text(f"{dump_task(load_task('loader-triangle-small'), 'loader')}{text}\n", encoding="utf-8")
    if message is None:
        task = load_task(file)
        assert (task.duration, task.timing) == (pytest.approx(duration), timing)
        assert replace(load_task(file), source="") == replace(task, source="")
    else:
        with pytest.raises(InputError) as caught:
            load_task(file)
        assert message in str(caught.value)

"""A task of your own: written as YAML, checked on loading, planned.

Usage: python 04_own_task.py [FOLDER]. Without a folder a temporary one is used. docs/files.md has every key.
"""

import sys
import tempfile
from pathlib import Path

import leanboom as lb

TASK = """\
machine: forwarder                # a bundled machine, or a file relative to this one
payload: 150 kg
path:
  type: lines                     # from rest to rest along each segment
  points: [[5.0, 0, 1.0], [5.0, 0, 3.0], [6.5, 1.5, 3.0]]   # x, y, z in m
  durations: [4 s, 5 s]
start: middle
"""


def main():
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp(prefix="leanboom-"))
    file = folder / "over-the-stake.yaml"
    file.write_text(TASK, encoding="utf-8")

    task = lb.load_task(file)
    motion = lb.plan(task, pump="cp", grid=(61, 41), step=0.2)
    print(motion)
    print(lb.evaluate(task, motion))

    # Mistakes in a file are all named at once, with line and key.
    wrong = folder / "wrong.yaml"
    wrong.write_text(TASK.replace("150 kg", "150 m").replace("durations", "duration"), encoding="utf-8")
    try:
        lb.load_task(wrong)
    except lb.InputError as error:
        print("a file with two mistakes is refused:")
        print(str(error).replace(str(folder), "..."))


if __name__ == "__main__":
    main()

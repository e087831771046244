"""A library of a few motions: built once, asked in real time, led over from where the extension really is.

The bundled specification forwarder-work-area covers both sides of the machine:
leanboom library build forwarder-work-area --out work-area
"""

import sys
import tempfile
import time
from pathlib import Path

from leanboom.library import engine, specification
from leanboom.library.lookup import Library

SPEC = """
machine: forwarder
origins: {type: points, points: [[4.3, 0, 2.5]]}
goals: {type: points, points: [[5.5, 0, 2.0]]}
shape: {type: straight}
durations: [3 s, 4 s]
pumps: [cp]
starts: [0.3 m]
"""


def main(folder):
    (folder / "few.yaml").write_text(SPEC)
    made = specification.load(folder / "few.yaml")
    print(engine.build(made, folder / "few", workers=1))
    with Library(folder / "few") as library:
        for longest in (3.0, 4.0):
            began = time.perf_counter()
            answer = library.query((4.3, 0, 2.5), (5.5, 0, 2.0), max_duration=longest, pump="cp", extension=0.35)
            took = 1e3 * (time.perf_counter() - began)
            print(f"{longest:g} s, after {took:.1f} ms: {answer.entry.energy_j / 1e3:.2f} kJ")
            print(library.judged(answer))


if __name__ == "__main__":  # builds use processes
    main(Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp()))

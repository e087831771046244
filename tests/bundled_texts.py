"""Texts of bundled files, and files made of texts."""

from __future__ import annotations

from pathlib import Path

import leanboom

PACKAGE = Path(leanboom.__file__).parent
FORWARDER = (PACKAGE / "machines/forwarder.yaml").read_text()
HALF_CYCLE = (PACKAGE / "tasks/forwarder-half-cycle.yaml").read_text()
TRIANGLE = (PACKAGE / "tasks/loader-triangle-large.yaml").read_text()


def written(folder, text, name="bad.yaml"):
    """A file with this text."""
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path

"""Type of the functions that report the progress of long work."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, float], None]  # called with what happens, and the share done


def quiet(text: str, share: float) -> None:
    """Progress that is not reported."""

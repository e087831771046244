"""How long work says what it does at the moment."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, float], None]  # called with what happens, and the share done


def quiet(text: str, share: float) -> None:
    """Progress that nobody looks at."""

"""The decorator of physical formulas.

A formula is a plain function of numbers written with NumPy ufuncs only. The same function then runs on
arrays, inside compiled kernels (numba) and on CasADi symbols. Numba is only told about the function if
and when it is imported, so that commands without kernels start quickly.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

F = TypeVar("F", bound=Callable)

_REGISTERED: list[Callable] = []


def formula(function: F) -> F:
    """Mark a function as a formula, callable from kernels once `enable_in_kernels` has run."""
    _REGISTERED.append(function)
    return function


def enable_in_kernels() -> None:
    """Make all formulas callable inside numba kernels; called by `bellman` on import."""
    from numba.extending import register_jitable

    while _REGISTERED:
        register_jitable(_REGISTERED.pop())

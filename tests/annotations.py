"""Annotations are checked in every test, on the first calls of each function in it.

Checking every call doubles the time of the tests: loops call the same functions with the same
shapes thousands of times.
"""

import functools
import sys
from collections import Counter
from collections.abc import Callable
from typing import Any

from beartype import beartype

CHECKS = 16
"""Of arguments and of results, together, for each function in each test."""

_checks: Counter[tuple[str, str]] = Counter()
_left: list[Any] = []


def checked(function: Callable) -> Callable:
    """A stand-in of a function that checks its arguments and result, made by jaxtyping."""
    check: Callable | None = None  # made at the first call: many functions have none
    place = function.__module__, function.__qualname__

    @functools.wraps(function)
    def counted(*arguments: Any, **named: Any) -> Any:
        nonlocal check
        if check is None:
            check = beartype(function)
        _checks[place] += 1
        if _checks[place] == CHECKS:
            _leave(*place)
        return check(*arguments, **named)

    return counted


def check_anew() -> None:
    """Check the next calls of all functions: a test begins."""
    _checks.clear()
    while _left:
        del _left.pop().__no_type_check__


def _leave(module: str, path: str) -> None:
    """Have jaxtyping call a function as it is; local ones and those of nobody stay checked.

    So do those of commands: the mark for jaxtyping would hide their annotations from tyro.
    """
    if module.startswith("instok3d.cli."):
        return
    found: Any = sys.modules.get(module)
    for name in path.split("."):
        found = vars(found).get(name) if hasattr(found, "__dict__") else None
    found = getattr(found, "fget", getattr(found, "__func__", found))
    while hasattr(found, "__wrapped__"):
        found = found.__wrapped__
    if callable(found):
        found.__no_type_check__ = True
        _left.append(found)

"""Results of pure functions, kept for the arguments that can be compared."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


def kept(size: int) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Keep the last ``size`` results of a function that has no other effect.

    Where an argument has no hash (a plugin may have a list for a field) it is called anew.
    """

    def around(function: Callable[P, R]) -> Callable[P, R]:
        results = lru_cache(maxsize=size)(function)

        @wraps(function)
        def asked(*args: P.args, **kwargs: P.kwargs) -> R:
            try:
                hash((args, tuple(kwargs.values())))
            except TypeError:
                return function(*args, **kwargs)
            return results(*args, **kwargs)

        return asked

    return around

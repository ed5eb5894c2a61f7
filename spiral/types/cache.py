"""A cache for pure functions whose arguments may have no hash."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


def kept(size: int) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorator: cache the last ``size`` results of a function without side effects.

    Where an argument has no hash (a plugin may have a list for a field) the function is called.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        results = lru_cache(maxsize=size)(function)

        @wraps(function)
        def cached_call(*args: P.args, **kwargs: P.kwargs) -> R:
            try:
                hash((args, tuple(kwargs.values())))
            except TypeError:
                return function(*args, **kwargs)
            return results(*args, **kwargs)

        return cached_call

    return decorate

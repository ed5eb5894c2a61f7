"""A cache for pure functions whose arguments may have no hash."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, wraps
from threading import RLock
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")
_LOCK = RLock()  # symbolic algebra and compilers are not made for several threads


def kept(size: int) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorator: cache the last ``size`` results of a function without side effects.

    Where an argument has no hash (a plugin may have a list for a field) the function is called.
    Only one thread at a time is inside such functions: they trace and compile, and must not wait
    for other threads.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        results = lru_cache(maxsize=size)(function)

        @wraps(function)
        def cached_call(*args: P.args, **kwargs: P.kwargs) -> R:
            try:
                hash((args, tuple(kwargs.values())))
                call = results
            except TypeError:
                call = function
            with _LOCK:
                return call(*args, **kwargs)

        return cached_call

    return decorate

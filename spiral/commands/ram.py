"""Errors for too little memory: a check before heavy libraries load, a message afterwards."""

from __future__ import annotations

from spiral.types.errors import ConfigError, InputError

NEEDED = 10**9
"""Bytes of address space below which the libraries may fail to start (measured: 0.8e9 suffice for
a short record on two cores; every core more takes some for its thread)."""


def check_memory_limit() -> None:
    """Refuse to start under a limit of memory in which importing fails.

    Raises
    ------
    ConfigError : ``ulimit -v`` below what the libraries need.
    """
    try:
        import resource
    except ImportError:  # a system without such limits
        return
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit not in (-1, resource.RLIM_INFINITY) and limit < NEEDED:
        raise ConfigError(
            f"a limit of {limit / 1e9:.2g} GB of memory (ulimit -v {limit // 1024})",
            f"at least {NEEDED / 1e9:.2g} GB, which the numerical libraries take to start",
            f"ulimit -v unlimited, or {-(-NEEDED // 1024)} and more",
        )


def out_of_memory_error() -> InputError:
    """The error for work that needed more memory than there is."""
    return InputError(
        "a record and model that need more memory than there is",
        "memory for all of their windows and parameters",
        "a shorter record (record.rows=[0,10000]), fewer candidates, or a higher limit (ulimit -v)",
    )

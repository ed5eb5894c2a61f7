"""Which cases of a parametrized test run by default; the others are slow (`make test-slow`)."""

from collections.abc import Iterable, Sequence
from typing import Any

import pytest


def others_slow(cases: Iterable[Any], quick: int) -> Sequence[Any]:
    """All cases of a test; those after the first ``quick`` are marked slow."""
    return [
        case
        if number < quick
        else pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow)
        for number, case in enumerate(cases)
    ]

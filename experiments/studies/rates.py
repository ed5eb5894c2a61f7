"""Rates with their intervals, and how tables write them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from statsmodels.stats.proportion import proportion_confint

Row = dict[str, Any]


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a rate of ``hits`` among ``count``."""
    if count == 0:
        return 0.0, 1.0
    low, high = proportion_confint(hits, count, method="wilson")
    return float(low), float(high)


def rate(rows: Sequence[Any], hit: Callable[[Any], bool]) -> dict[str, Any]:
    """A share of rows with its interval."""
    hits = sum(bool(hit(row)) for row in rows)
    return {
        "rate": hits / len(rows) if rows else None,
        "hits": hits,
        "count": len(rows),
        "interval": wilson(hits, len(rows)),
    }


def rate_told(found: dict[str, Any]) -> str:
    """``93.3% (70.2% to 98.8%)``, or a dash where there was nothing to count."""
    if found["rate"] is None:
        return "-"
    low, high = found["interval"]
    return f"{found['rate']:.1%} ({low:.1%} to {high:.1%})"


def number_told(value: float | None) -> str:
    """Three digits, or a dash."""
    return "-" if value is None else f"{value:.3g}"

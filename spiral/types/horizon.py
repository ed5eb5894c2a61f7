"""Prediction errors at a horizon, and whether one model predicts better than another there.

With y^_j(t | t - h) what is predicted of channel j from all that was measured up to t - h, and s_j
the standard deviation of the channel over the samples that are scored,

    e_j(h) = sqrt(mean_t (y_j(t) - y^_j(t | t - h))^2) / s_j,        e(h) = mean_j e_j(h).

Two models a and b are compared on the same samples. Squared errors are kept as means over blocks
of time, m_jb; since sqrt(m') - sqrt(m) = (m' - m) / (sqrt(m') + sqrt(m)), the difference of two
errors is itself a mean over blocks,

    e_b - e_a = mean_b D_b,    D_b = mean_j (m'_jb - m_jb) / (e'_j + e_j),

and its standard error that of a mean of paired differences. Errors of neighbouring samples are
correlated, those of blocks hardly.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

Judged = Literal["better", "same", "worse"]

_EQUAL = 0.005  # share of an error below which a change counts as none: equal in three digits


@dataclass(frozen=True)
class Horizon:
    """Errors of one model at one horizon, on records that its fit did not see.

    ``name`` is ``one_sample``, ``ahead`` or ``free_run``; ``samples`` and ``seconds`` how far
    ahead, none for the free run. ``squares`` are m_jb of every channel: squared errors over s_j^2,
    each block weighted so that its plain mean is that of all samples; infinite where a prediction
    left all bounds.
    """

    name: str
    samples: int | None
    seconds: float | None
    squares: Mapping[str, tuple[float, ...]]

    @property
    def channels(self) -> dict[str, float]:
        """e_j of every channel."""
        return {name: float(np.sqrt(np.mean(m))) for name, m in self.squares.items()}

    @property
    def error(self) -> float:
        """e, the mean over channels."""
        return float(np.mean(list(self.channels.values())))

    def as_dict(self) -> dict[str, Any]:
        """As plain data, as ``--json`` writes it."""
        return {
            "horizon": self.name,
            "samples": self.samples,
            "seconds": self.seconds,
            "error": self.error,
            "channels": self.channels,
        }


@dataclass(frozen=True)
class Change:
    """Change of the error at one horizon by a step.

    ``judged`` is ``same`` where the difference is within its ``standard_error``, or below half a
    percent of the error.
    """

    horizon: str
    samples: int | None
    seconds: float | None
    before: float
    after: float
    standard_error: float
    judged: Judged

    def as_dict(self) -> dict[str, Any]:
        """As plain data, as ``--json`` writes it."""
        return {
            "horizon": self.horizon,
            "samples": self.samples,
            "seconds": self.seconds,
            "before": self.before,
            "after": self.after,
            "standard_error": self.standard_error,
            "judged": self.judged,
        }


def changes(before: tuple[Horizon, ...], after: tuple[Horizon, ...]) -> tuple[Change, ...]:
    """Better, same or worse, at every horizon at which both models were evaluated."""
    known = {h.name: h for h in before}
    return tuple(_change(known[h.name], h) for h in after if h.name in known)


def _change(before: Horizon, after: Horizon) -> Change:
    old, new = before.error, after.error
    spread = _standard_error(before, after) if np.isfinite(old + new) else np.inf
    judged: Judged = "better" if new < old else "worse"
    if old == new or (np.isfinite(old + new) and abs(new - old) <= max(spread, _EQUAL * old)):
        judged = "same"
    return Change(after.name, after.samples, after.seconds, old, new, spread, judged)


def _standard_error(before: Horizon, after: Horizon) -> float:
    """Of e_b - e_a, from the spread of D_b over blocks; infinite where there is one block only."""
    a, b = before.channels, after.channels
    parts = [
        (np.array(after.squares[j]) - np.array(before.squares[j])) / (a[j] + b[j])
        for j in b
        if a[j] + b[j] > 0
    ]
    if not parts or len(parts[0]) < 2:
        return 0.0 if not parts else np.inf
    each = np.sum(parts, axis=0) / len(b)
    return float(np.std(each, ddof=1) / np.sqrt(len(each)))

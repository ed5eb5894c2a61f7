"""Learners: a smooth function from the observable regressor to the residual, r = f(xi).

The paper's Step 2: what the model cannot explain is first learned without structure, and then
read off the learned function. Every equation's residual is one output of one function.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from spiral.types.errors import InputError
from spiral.types.plugin import Plugin
from spiral.types.record import Array

Tell = Callable[[str], None]


@dataclass(frozen=True)
class Learned:
    """A learned function with the log of its fit.

    ``predict(xi)`` takes (N, n) and gives (N, C) in the residual's unit; ``log`` is plain data.
    """

    predict: Callable[[Array], Array]
    log: Mapping[str, Any]


class Learner(Plugin):
    """How the residual is learned.

    Its fields are the configuration's ``learner.FIELD``. Callers use ``learned``, which scales
    inputs and outputs to zero mean and unit variance; a plugin may assume that.
    """

    kind: ClassVar[str] = "learner"

    @abstractmethod
    def fit(self, xi: Array, r: Array, train: Array, seed: int, tell: Tell) -> Learned:
        """Fit r (N, C) as a function of xi (N, n), both scaled.

        Parameters
        ----------
        train : (N,) True for samples to fit, False for those that only decide when to stop.
        seed : of every random choice; the same seed gives the same function.
        tell : told in words how far it is.
        """


def learned(
    learner: Learner, xi: Array, r: Array, train: Array, seed: int, tell: Tell = lambda _: None
) -> Learned:
    """Fit a learner to scaled samples; its function is in the units of xi and r.

    The log adds, for the training and the validation samples, the share of the residual's energy
    that is left: sum (r - f)^2 / sum r^2.

    Raises
    ------
    InputError : values that are not finite, or nothing to train or to validate on.
    """
    if not (np.isfinite(xi).all() and np.isfinite(r).all()):
        raise InputError("a residual that is not finite", "finite samples", "another derivative=")
    if not (train.any() and (~train).any()):
        raise InputError("no samples to train or to validate on", "both", "settings of the split")
    middle, spread = xi[train].mean(axis=0), _column_scales(xi[train])
    level, size = r[train].mean(axis=0), _column_scales(r[train])
    scaled = (xi - middle) / spread
    scaled_fit = learner.fit(scaled, (r - level) / size, train, seed, tell)

    def predict(points: Array) -> Array:
        return scaled_fit.predict((points - middle) / spread) * size + level

    left = (r - predict(xi)) ** 2
    shares = {
        name: float(left[part].sum() / max(float(np.sum(r[part] ** 2)), 1e-300))
        for name, part in (("train_left", train), ("validation_left", ~train))
    }
    return Learned(predict, {**scaled_fit.log, **shares})


def _column_scales(values: Array) -> Array:
    deviation = values.std(axis=0)
    return np.where(deviation > 0, deviation, 1.0)

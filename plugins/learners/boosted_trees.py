"""Gradient-boosted trees in place of a network."""

from __future__ import annotations

import numpy as np

from spiral.types.learner import Learned, Learner, Tell
from spiral.types.record import Array


class BoostedTrees(Learner):
    """f(xi) = sum_m rate tree_m(xi), each tree fitted to what the ones before it leave.

    One sum for every equation, stopped on the validation samples. Piecewise constant, so nothing
    outside the data's range is extrapolated. ``sklearn.ensemble.HistGradientBoostingRegressor``.

    Fields
    ------
    rate : share of each tree that is added. trees : at most so many. leaves : of each tree.
    """

    rate: float = 0.1
    trees: int = 150
    leaves: int = 31

    def fit(self, xi: Array, r: Array, train: Array, seed: int, tell: Tell) -> Learned:
        """Trees for every output."""
        from sklearn.ensemble import HistGradientBoostingRegressor
        from threadpoolctl import threadpool_limits

        models = []
        for column in range(r.shape[1]):
            tell(f"boosted trees for equation {column + 1} of {r.shape[1]}")
            model = HistGradientBoostingRegressor(
                learning_rate=self.rate,
                max_iter=self.trees,
                max_leaf_nodes=self.leaves,
                early_stopping=True,
                n_iter_no_change=10,
                random_state=seed,
            )
            held = (xi[~train], r[~train, column])
            with threadpool_limits(1, user_api="openmp"):
                model.fit(xi[train], r[train, column], X_val=held[0], y_val=held[1])
            models.append(model)

        def predict(points: Array) -> Array:
            return np.column_stack([m.predict(points) for m in models])

        return Learned(predict, {"trees": [int(m.n_iter_) for m in models]})

"""Gate 1 and its refinements that look at terms one by one."""

from __future__ import annotations

import numpy as np

from spiral.engine.gate import Gate, Judgement, Trial
from spiral.engine.leastsquares import least_squares


class BonferroniT(Gate):
    """Gate 1: |t_l| > t_{alpha/(2 L), N_H - L} on the learned surface (paper, eq. gate1).

    t = theta / SE of the least squares fit over the Halton points. The surface is a function
    without noise, so t grows with the number of points and nearly everything passes; it is no
    evidence, and the pass rate is logged beside it. Without a surface (``paper.sampling=samples``)
    the training residual is regressed instead.

    Fields
    ------
    alpha : family-wise error over the L candidates.
    """

    alpha: float = 0.05

    def judge(self, trial: Trial) -> Judgement:
        """The candidates whose t passes."""
        from scipy import stats

        names = trial.names
        if trial.surface is not None:
            fit = trial.surface.fit
        else:
            x = trial.candidates[trial.train].reshape(-1, len(names))
            fit = least_squares(x, trial.residual[trial.train].reshape(-1))
        critical = float(stats.t.isf(self.alpha / (2 * len(names)), max(fit.rows - len(names), 1)))
        t = fit.t
        kept = tuple(k for k in trial.kept if abs(t[k]) > critical)
        log = {
            "critical": critical,
            "passed": len(kept),
            "tested": len(trial.kept),
            "pass_rate": len(kept) / len(trial.kept),
            "t": {names[k]: float(t[k]) for k in trial.kept},
            "coefficient": {names[k]: float(fit.b[k]) for k in trial.kept},
        }
        refused = {
            names[k]: f"Gate 1: |t| = {abs(t[k]):.3g}, {critical:.3g} needed"
            for k in trial.kept
            if k not in kept
        }
        return Judgement(kept, log, "" if kept else "no_term_passes_gate_1", refused)


class CorrelationCluster(Gate):
    """Refinement 1: of terms with |rho| > 0.7 only the strongest, m = argmax gain, is carried on.

    rho is the correlation of two columns on the training samples; clusters are its connected
    components. The strongest is the term that alone lowers the training sum of squares most,
    beside the current model (the paper does not say what strong means).

    Fields
    ------
    threshold : |rho| above which two terms belong together.
    """

    threshold: float = 0.7

    def judge(self, trial: Trial) -> Judgement:
        """One term of each cluster."""
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import connected_components

        kept = trial.kept
        columns = trial.candidates[trial.train][..., list(kept)].reshape(-1, len(kept))
        centred = columns - columns.mean(axis=0)
        norms = np.linalg.norm(centred, axis=0)
        unit = centred / np.where(norms > 0, norms, 1.0)
        together = np.abs(unit.T @ unit) > self.threshold
        count, labels = connected_components(csr_array(together), directed=False)
        gains = _single_term_gains(trial)
        clusters, strongest, refused = [], [], {}
        for number in range(count):
            members = [kept[i] for i in np.flatnonzero(labels == number)]
            first = max(members, key=lambda k: gains[k])
            strongest.append(first)
            names = [trial.names[k] for k in members]
            if len(members) > 1:
                clusters.append({"carried": trial.names[first], "members": names})
            for k in members:
                if k != first:
                    refused[trial.names[k]] = f"in one cluster with {trial.names[first]}"
        log = {"clusters": clusters, "count": count, "carried": len(strongest)}
        return Judgement(tuple(sorted(strongest)), log, "", refused)


def _single_term_gains(trial: Trial) -> dict[int, float]:
    """Fall of the training sum of squares for each candidate alone beside the current model."""
    x, y = trial.rows(trial.kept, trial.train)
    width = trial.active.shape[2]
    before = trial.before
    q = x[:, :width] @ before.inverse  # orthonormal where columns were kept
    rest = y - x[:, :width] @ before.b
    gains = {}
    for i, k in enumerate(trial.kept):
        column = x[:, width + i]
        own = column - q @ (q.T @ column)
        size = float(own @ own)
        tiny = 1e-18 * float(column @ column)
        gains[k] = float(own @ rest) ** 2 / size if size > tiny else 0.0
    return gains


class Contribution(Gate):
    """Refinement 3: a term is refused where s = |theta| RMS(phi) / RMS(r) is negligible.

    theta from the joint fit with the current model on the training samples, r the current residual
    there; scale-invariant.

    Fields
    ------
    share : smallest contribution (the paper gives no number).
    """

    share: float = 0.02

    def judge(self, trial: Trial) -> Judgement:
        """The terms that contribute."""
        fit = trial.fitted(trial.kept)
        theta = fit.b[trial.active.shape[2] :]
        columns = trial.candidates[trial.train][..., list(trial.kept)]
        size = np.abs(theta) * np.sqrt(np.mean(columns**2, axis=(0, 1)))
        shares = size / float(np.sqrt(np.mean(trial.residual[trial.train] ** 2)))
        pairs = list(zip(trial.kept, shares, strict=True))
        kept = tuple(k for k, s in pairs if s >= self.share)
        log = {"share": {trial.names[k]: float(s) for k, s in pairs}, "smallest": self.share}
        refused = {
            trial.names[k]: f"contributes {s:.2%} of the residual, {self.share:.2%} needed"
            for k, s in pairs
            if s < self.share
        }
        return Judgement(kept, log, "" if kept else "no_term_passes_a_refinement", refused)

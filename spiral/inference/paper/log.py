"""The log of every round of ``strategy=paper``, as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import special

from spiral.engine.gate import Trial
from spiral.engine.leastsquares import (
    Fit,
    adjusted_r2,
    least_squares,
    partial_f,
    press,
    t_values,
    variance_inflation,
)
from spiral.inference.paper.robust import automatic_lags, hac_errors
from spiral.types.library import Term
from spiral.types.record import Array
from spiral.types.run import Suggestion


def model_log(
    trial: Trial, names: tuple[str, ...], terms: Mapping[str, Term]
) -> tuple[dict[str, Any], dict[str, float]]:
    """Coefficients of the current model with plain and robust errors, and its diagnostics.

    Returns
    -------
    The log, and the robust standard error of every amplitude: those that the model reports.
    """
    fit, lags = trial.before, automatic_lags(trial)
    robust = hac_errors(trial, (), fit, lags)
    x, y = trial.rows((), trial.train)
    table, errors = {}, {}
    for name, b, plain, hac in zip(names, fit.b, fit.se, robust, strict=True):
        table[name] = _coefficient_row(b, plain, hac, terms.get(name))
        if " " not in name:
            errors[name] = float(hac)
    for name in {n.split(" ")[0] for n in names if " " in n}:
        pair = [i for i, n in enumerate(names) if n.startswith(f"{name} ")]
        errors[name] = float(np.sqrt(np.mean(robust[pair] ** 2)))
    inflation = variance_inflation(x)
    diagnostics = {
        "press": press(x, y, fit),
        "adjusted_r2": adjusted_r2(y, fit),
        "vif": {n: float(v) for n, v in zip(names, inflation, strict=True)},
        "rss": fit.rss,
        "samples": fit.rows,
        "parameters": fit.parameters,
        "validation_rmse": trial.rmse(fit, (), ~trial.train),
    }
    return {"coefficients": table, "diagnostics": diagnostics, "hac_lags": lags}, errors


def _coefficient_row(b: Any, plain: Any, hac: Any, term: Term | None) -> dict[str, Any]:
    row: dict[str, Any] = {
        "estimate": float(b),
        "se_ols": float(plain),
        "t_ols": float(t_values(np.array(b), np.array(plain))),
        "se_hac": float(hac),
        "t_hac": float(t_values(np.array(b), np.array(hac))),
    }
    if term is not None:
        row |= {"category": term.category, "mechanism": term.mechanism}
        if term.predicted is not None:
            row["predicted"] = term.predicted
    return row


def term_log(trial: Trial, terms: Mapping[str, Term]) -> dict[str, Any]:
    """Every admitted term in the joint fit, as a whole and in each equation alone.

    The paper's terms have a coefficient in every equation; those of an effect that acts on both
    axes are given under ``by_equation``.
    """
    fit, lags = trial.fitted(trial.kept), automatic_lags(trial)
    robust = hac_errors(trial, trial.kept, fit, lags)
    width = trial.active.shape[2]
    table = {}
    for i, k in enumerate(trial.kept):
        name = trial.names[k]
        row = _coefficient_row(fit.b[width + i], fit.se[width + i], robust[width + i], terms[name])
        if np.all(np.any(trial.candidates[..., k] != 0, axis=0)) and trial.target.shape[1] > 1:
            row["by_equation"] = _by_equation(trial, i, lags)
        table[name] = row
    return table


def _by_equation(trial: Trial, position: int, lags: int) -> list[dict[str, float]]:
    """One admitted term with a coefficient of its own in every equation."""
    column = trial.candidates[..., trial.kept[position]]
    count = trial.target.shape[1]
    split = column[..., None] * np.eye(count)
    others = [k for i, k in enumerate(trial.kept) if i != position]
    active = np.concatenate([trial.active, trial.candidates[..., others], split], axis=2)
    wide = Trial(
        (), (), trial.target, active, active[..., :0], trial.residual, trial.train,
        trial.amplitude, trial.record,
    )  # fmt: skip
    fit = wide.before
    robust = hac_errors(wide, (), fit, lags)
    last = range(len(fit.b) - count, len(fit.b))
    return [_coefficient_row(fit.b[i], fit.se[i], robust[i], None) for i in last]


def suggestions(
    trial: Trial, terms: Mapping[str, Term], aliases: Mapping[str, tuple[str, ...]]
) -> tuple[Suggestion, ...]:
    """The batch's effects, by how much their terms alone explain of the training residual."""
    x, y = trial.rows(trial.kept, trial.train)
    width = trial.active.shape[2]
    whole, lags = trial.fitted(trial.kept), automatic_lags(trial)
    t = t_values(whole.b, hac_errors(trial, trial.kept, whole, lags))[width:]
    best: dict[str, Suggestion] = {}
    for i, k in enumerate(trial.kept):
        term = terms[trial.names[k]]
        others = [j for j in range(x.shape[1]) if j != width + i]
        without = least_squares(x[:, others], y)
        value, p = partial_f(without, whole)
        label = term.effect.label
        alone = trial.before.rss - least_squares(x[:, [*range(width), width + i]], y).rss
        item = Suggestion(
            effect=label,
            meaning=term.mechanism,
            aliases=aliases.get(label, ()),
            p_value=p,
            statistic=value,
            wald_p_value=float(2 * special.ndtr(-abs(t[i]))),
            explains=float(alone / trial.before.rss) if trial.before.rss > 0 else 0.0,
        )
        if label not in best or best[label].explains < item.explains:
            best[label] = item
    return tuple(sorted(best.values(), key=lambda s: -s.explains))


def closure_log(trial: Trial, predicted: Array) -> dict[str, Any]:
    """What the learned residual itself would add as a term of each equation: F, and validation.

    It is reported and not added: a function is its own projection (coefficient 1), it has no
    physical origin, and the paper calls it no part of the final model.
    """
    split = predicted[..., None] * np.eye(predicted.shape[1])
    both = np.concatenate([trial.active, split], axis=2)
    before = trial.before
    after: Fit = least_squares(
        both[trial.train].reshape(-1, both.shape[2]), trial.target[trial.train].reshape(-1)
    )
    value, p = partial_f(before, after)
    held = ~trial.train
    left = trial.target[held].reshape(-1) - both[held].reshape(-1, both.shape[2]) @ after.b
    return {
        "statistic": value,
        "p_value": p,
        "coefficients": [float(b) for b in after.b[-predicted.shape[1] :]],
        "rmse_before": trial.rmse(before, (), held),
        "rmse_after": float(np.sqrt(np.mean(left**2))),
    }

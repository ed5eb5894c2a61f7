"""Figures of comparisons as clauses of a sentence: what is left, and errors on unseen data."""

from __future__ import annotations

import numpy as np

from spiral.inference.disturbances import what_acts
from spiral.inference.nearness import (
    evidence_chi2,
    has_own_colour,
    is_free_run_carried_away,
    is_moved_unseen,
    next_sample_error,
    takes_most,
)
from spiral.inference.problem import Settings
from spiral.types.formatting import number, percent
from spiral.types.run import Comparison


def figures_clause(comparison: Comparison, settings: Settings) -> str:
    """What is left of a comparison, and its error on unseen data beside the noise floor."""
    floor = percent(comparison.floor)
    error = f"the test error is {percent(comparison.test_error)} (noise floor {floor})"
    if (
        is_free_run_carried_away(comparison)
        and (ahead := next_sample_error(comparison)) is not None
    ):
        error = (
            f"one sample ahead the error on unseen data is {percent(ahead)} (noise floor {floor}); "
            f"a free run is no test here: {_why_carried_away(comparison)}"
        )
    if comparison.random is not None:
        kind = "white noise" if comparison.whiteness_p >= settings.whiteness_level else "noise"
        if has_own_colour(comparison, settings):
            share = percent(comparison.whiteness_effect)
            kind += f" (its own past predicts about {share} of it, motion and inputs do not)"
        return f"what is left is {kind}, and {error}"
    return (
        f"chi2 per degree of freedom is {number(evidence_chi2(comparison), 3)}, what is left is "
        f"white, and {error}"
    )


def error_clause(first: Comparison, last: Comparison) -> str:
    """The error on unseen data before and after: of free runs, or else one sample ahead."""
    before, after = next_sample_error(first), next_sample_error(last)
    floor = percent(last.floor)
    if is_free_run_carried_away(last) and before is not None and after is not None:
        return (
            f"error one sample ahead {percent(before)} -> {percent(after)} (noise floor {floor}; "
            f"a free run is no test: {_why_carried_away(last)})"
        )
    now = f"{percent(last.test_error)} (noise floor {floor})"
    if not np.isfinite(first.test_error):
        return f"the free run ran away before, and is off by {now} on the test record now"
    return f"test error {percent(first.test_error)} -> {now}"


def growth_excuse(first: Comparison, last: Comparison) -> str:
    """Why a larger free-run error does not count against the effects; empty where it fell."""
    before, after = next_sample_error(first), next_sample_error(last)
    grown = last.test_error > first.test_error and not is_free_run_carried_away(last)
    if not grown or before is None or after is None:
        return ""
    fitted = (
        f"; of the record that was fitted {percent(first.fit_error)} -> {percent(last.fit_error)}"
        if takes_most(first.fit_error, last.fit_error)
        else ""
    )
    return (
        f", which noise and random {what_acts(last.model)}s explain in a free run; one sample "
        f"ahead {percent(before)} -> {percent(after)}{fitted}"
    )


def _why_carried_away(comparison: Comparison) -> str:
    """Why a free run errs by all the motion, whatever the model is."""
    if is_moved_unseen(comparison):
        return "what moves the machine is in no input"
    return f"random {what_acts(comparison.model)}s or uncertain values move it too far"

"""What a run says, held against what is known of the answer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from spiral.types.run import Run

Row = dict[str, Any]
TOP = 3  # suggestions that are kept


def groups(run: Run) -> list[tuple[str, set[str]]]:
    """Every effect admitted, in order, with its alias group."""
    return [(x, {x, *r.aliases.get(x, ())}) for r in run.rounds for x in r.admitted]


def named(run: Run, hidden: Sequence[str], also: Sequence[str] = ()) -> Row:
    """Ranks of what is hidden, counting alias groups, and what else was admitted.

    ``hidden`` are labels of which any is right; ``also`` are labels that are no invention either:
    the imperfection of the record, where the catalog has one. It may come before what is hidden.
    """
    right, found = set(hidden), groups(run)
    ranked = run.rounds[0].suggestions[:TOP]
    before = [group for _, group in found if group & right or not group & set(also)]
    first = bool(before) and bool(right & before[0])
    top = first or any(right & {s.effect, *s.aliases} for s in ranked)
    return {
        "first": first,
        "top": bool(right) and top,
        "alone": first and found[0][1] <= right,
        "aliases": sorted(found[0][1] - {found[0][0]}) if found else [],
        "admitted": [x for x, _ in found],
        "invented": [x for x, group in found if not group & (right | set(also))],
        "suggested": [s.effect for s in ranked],
    }


def coefficient(run: Run, truth: Mapping[str, float]) -> Row:
    """The first hidden amplitude that the final model has: estimate, error in se, relative error.

    ``truth`` by full name: ``cubic_stiffness@link.stiffness``.
    """
    table = run.model.estimates()
    for key, value in truth.items():
        owner, name = key.rsplit(".", 1)
        found = table.get(owner, {}).get(name)
        if found is not None and found.se:
            return {
                "coefficient": key,
                "estimate": found.estimate,
                "se": found.se,
                "truth": value,
                "error_se": (found.estimate - value) / found.se,
                "error_relative": found.estimate / value - 1.0 if value else None,
            }
    return {"coefficient": None, "error_se": None, "error_relative": None}


def told(run: Run) -> Row:
    """Verdict, sentence, and the figures of the seed and of the final model."""
    seed, last = run.rounds[0].comparison, run.final
    chi2 = last.chi2_per_dof if last.innovation_chi2 is None else last.innovation_chi2
    return {
        "verdict": run.verdict,
        "stopped": run.stopped,
        "summary": run.summary,
        "advice": run.advice,
        "rounds": len(run.rounds) - 1,
        "chi2": chi2,
        "chi2_of": "windows" if last.innovation_chi2 is None else "innovations",
        "converged": last.converged,
        "before": seed.test_error,
        "after": last.test_error,
        "floor": last.noise_floor,
        "fit": last.fit_error,
        "rmse": [c.rmse for c in last.channels.values()],
        "final": list(run.missing),
    }


def inside(run: Run, truth: Mapping[str, float], z: float = 1.959964) -> dict[str, bool]:
    """Whether the 95 % interval of each fitted parameter holds its true value."""
    found = {}
    for owner, table in run.model.estimates().items():
        for name, estimate in table.items():
            key = f"{owner}.{name}"
            if key in truth and estimate.se:
                found[key] = abs(estimate.estimate - truth[key]) <= z * estimate.se
    return found

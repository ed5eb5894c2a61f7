"""Verbs that look ahead, before any fit: whether a record or a planned test is rich enough."""

from __future__ import annotations

from spiral.verbs import OK, REFUSED, Outcome, Study


def identify(study: Study) -> Outcome:
    """Rank, mu, condition, alias groups and samples needed; refuses where terms look alike."""
    from spiral.config import build_derivative
    from spiral.identify import identify as judge

    problem = study.problem()
    found = judge(problem, build_derivative(study.config, study.registry), study.tell)
    result = found.as_dict()
    result["run_id"] = study.save(result, problem.model, problem)
    refused = found.verdict == "not_identifiable"
    if refused:
        groups = "; ".join(", ".join(g) for g in found.aliases)
        result["error"] = {
            "given": f"a record that shows {found.found.rank} of {found.found.columns} terms apart",
            "expected": f"excitation that tells apart {groups}",
            "try": found.advice,
        }
    return Outcome(REFUSED if refused else OK, result, study.parts(problem, found=found))

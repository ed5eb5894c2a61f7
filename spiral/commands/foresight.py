"""Verbs that look ahead, before any fit: whether a record or a planned test is rich enough."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from spiral.commands.study import Command
from spiral.io.request import OK, REFUSED, Outcome

if TYPE_CHECKING:
    from spiral.inference.plan import Outlook, Plan, Wanted
    from spiral.inference.plan_options import PlanOptions


def identify(study: Command) -> Outcome:
    """Rank, mu, condition, alias groups and samples needed; refuses where terms look alike."""
    from spiral.inference.identifiability.identify import identify as judge
    from spiral.io.config import build_derivative

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


def plan(study: Command) -> Outcome:
    """Planned tests ranked by what they tell; refuses where none answers the question."""
    from spiral.inference.plan import plan as judge
    from spiral.inference.plan_options import plan_options
    from spiral.inference.planned_tests import planned_tests, simulator

    problem = study.problem()
    wishes = plan_options(study.config.get("plan"))
    wanted = _wanted(study, wishes)
    tests = planned_tests(problem, wishes)
    found = judge(problem, wanted, tests, simulator(problem, study.registry.simulation), study.tell)
    result = _planned(found, wishes.shown)
    result["run_id"] = study.save(result, found.model, problem)
    refused = found.verdict == "not_answered" and not _open_question(wanted)
    if refused:
        result["error"] = {
            "given": f"{len(found.tests)} planned tests, of which none answers the question",
            "expected": "one that does",
            "try": found.advice,
        }
    parts = study.parts(problem, plan=found, shown=wishes.shown)
    return Outcome(REFUSED if refused else OK, result, parts)


def _open_question(wanted: Wanted) -> bool:
    """Whether tests are only ranked: a parameter without an error that it should have."""
    return not wanted.effects and wanted.standard_error is None


def _wanted(study: Command, wishes: PlanOptions) -> Wanted:
    """The question, from names after the verb or the section ``plan``."""
    from spiral.inference.plan import Wanted
    from spiral.types.errors import ConfigError

    labels = tuple(dict.fromkeys((*study.request.names, *wishes.effects)))
    if labels and wishes.parameter:
        raise ConfigError(
            f"plan {' '.join(labels)} with plan.parameter={wishes.parameter}",
            "effects to tell apart, or one parameter",
            "one question at a time",
        )
    if not labels and not wishes.parameter:
        raise ConfigError(
            "plan without a question",
            "effects to tell apart: spiral plan gyroscopic antisymmetric_damping run=latest",
            "or a parameter: plan.parameter=gyroscopic.coefficient plan.standard_error=1e-4",
        )
    if len(labels) == 1:
        raise ConfigError(f"plan {labels[0]} alone", "two effects or more", "its alias beside it")
    effects = tuple(study.registry.effect_from_label(label) for label in labels)
    return Wanted(effects, wishes.parameter or "", wishes.standard_error)


def _planned(found: Plan, shown: int) -> dict[str, Any]:
    """As the JSON contract writes it."""
    wanted = found.wanted
    return {
        "verdict": found.verdict,
        "question": {
            "effects": [e.label for e in wanted.effects],
            "parameter": wanted.parameter or None,
            "standard_error": wanted.standard_error,
            "unit": found.unit or None,
        },
        "now": _outlook(found.now, found),
        "tests": [_outlook(o, found) for o in found.tests],
        "suffices": found.suffices,
        "shown": shown,
        "advice": found.advice,
        "notes": list(found.notes),
    }


def _outlook(outlook: Outlook, found: Plan) -> dict[str, Any]:
    from spiral.inference.planned_tests import overrides_of

    test = outlook.test
    words = overrides_of(test, outlook.noise_share, found.model) if test.inputs else ()
    return {
        "test": test.words,
        "inputs": dict(test.inputs),
        "duration_s": test.duration,
        "rate_hz": test.rate,
        "unbalance": test.unbalance,
        "separates": outlook.probability,
        "noncentrality": outlook.noncentrality if outlook.pairs else None,
        "pairs": [p.as_dict() for p in outlook.pairs],
        "standard_error": outlook.error,
        "failure": outlook.failure or None,
        "overrides": list(words),
    }

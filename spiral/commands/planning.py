"""The verbs ``identify`` and ``plan``: whether a record or a planned test is informative enough."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from spiral.commands.study import Command
from spiral.io.request import OK, REFUSED, Outcome

if TYPE_CHECKING:
    from spiral.inference.plan import Plan, PlanQuestion, TestForecast
    from spiral.inference.plan_options import PlanOptions


def identify(study: Command) -> Outcome:
    """Rank, mu, condition, alias groups and samples needed; refuses where terms look alike."""
    from spiral.inference.identifiability.identify import identify as judge
    from spiral.io.config import build_derivative

    problem = study.problem()
    identification = judge(problem, build_derivative(study.config, study.registry), study.tell)
    result = identification.as_dict()
    result["run_id"] = study.save(result, problem.model, problem)
    refused = identification.verdict == "not_identifiable"
    if refused:
        groups = "; ".join(", ".join(g) for g in identification.aliases)
        result["error"] = {
            "given": f"a record that shows {identification.richness.rank} of "
            f"{identification.richness.columns} terms apart",
            "expected": f"excitation that tells apart {groups}",
            "try": identification.advice,
        }
    return Outcome(REFUSED if refused else OK, result, study.parts(problem, found=identification))


def plan(study: Command) -> Outcome:
    """Planned tests ranked by what they tell; refuses where none answers the question."""
    from spiral.inference.plan import plan as judge
    from spiral.inference.plan_options import plan_options
    from spiral.inference.planned_tests import planned_tests, simulator

    problem = study.problem()
    wishes = plan_options(study.config.get("plan"))
    wanted = _planning_question(study, wishes)
    tests = planned_tests(problem, wishes)
    test_plan = judge(
        problem, wanted, tests, simulator(problem, study.registry.simulation), study.tell
    )
    result = _plan_dict(test_plan, wishes.shown)
    result["run_id"] = study.save(result, test_plan.model, problem)
    refused = test_plan.verdict == "not_answered" and not _is_ranking_only(wanted)
    if refused:
        result["error"] = {
            "given": f"{len(test_plan.tests)} planned tests, of which none answers the question",
            "expected": "one that does",
            "try": test_plan.advice,
        }
    parts = study.parts(problem, plan=test_plan, shown=wishes.shown)
    return Outcome(REFUSED if refused else OK, result, parts)


def _is_ranking_only(wanted: PlanQuestion) -> bool:
    """Whether tests are only ranked: a parameter without an error that it should have."""
    return not wanted.effects and wanted.standard_error is None


def _planning_question(study: Command, wishes: PlanOptions) -> PlanQuestion:
    """The question, from names after the verb or the section ``plan``."""
    from spiral.inference.plan import PlanQuestion
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
    return PlanQuestion(effects, wishes.parameter or "", wishes.standard_error)


def _plan_dict(test_plan: Plan, shown: int) -> dict[str, Any]:
    """As plain data, as ``--json`` writes it."""
    wanted = test_plan.wanted
    return {
        "verdict": test_plan.verdict,
        "question": {
            "effects": [e.label for e in wanted.effects],
            "parameter": wanted.parameter or None,
            "standard_error": wanted.standard_error,
            "unit": test_plan.unit or None,
        },
        "now": _outlook_dict(test_plan.now, test_plan),
        "tests": [_outlook_dict(o, test_plan) for o in test_plan.tests],
        "suffices": test_plan.suffices,
        "shown": shown,
        "advice": test_plan.advice,
        "notes": list(test_plan.notes),
    }


def _outlook_dict(outlook: TestForecast, test_plan: Plan) -> dict[str, Any]:
    from spiral.inference.planned_tests import record_overrides

    test = outlook.test
    words = record_overrides(test, outlook.noise_share, test_plan.model) if test.inputs else ()
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

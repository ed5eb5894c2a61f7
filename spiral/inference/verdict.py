"""Verdicts: the conclusion from the figures of a study, as one word and in sentences.

An admitted effect is *determined* where one of its amplitudes has |t| >= ``least_t`` (or the
likelihood without the effect is as far off) and does not lie at a bound. Only such an effect is
named as what was missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from spiral.inference.disturbances import (
    random_forces,
    random_sentence,
    record_sentence,
)
from spiral.inference.effect_words import name_effects
from spiral.inference.figures_in_words import error_clause, figures_clause, growth_excuse
from spiral.inference.identifiability.undetermined import (
    describe_held_parameters,
    describe_undetermined_parameters,
    has_tied_effects,
)
from spiral.inference.nearness import (
    evidence_chi2,
    is_error_unexplained,
    is_free_run_carried_away,
    is_free_run_telling_little,
    is_moved_unseen,
    is_near_noise,
    is_residual_white,
    is_undecided,
    leaves_less_than_noise,
    noise_factor,
    predicts_nothing,
    shortfalls,
    takes_little,
    takes_most,
    unexplained_error_growth,
)
from spiral.inference.problem import Settings
from spiral.inference.unknown.memory import memory_sentence, memory_stand_ins
from spiral.types.formatting import number, percent
from spiral.types.horizon import changes
from spiral.types.label import split_key
from spiral.types.model import Model
from spiral.types.run import (
    RANDOM_OR_MISSING,
    UNTOLD,
    Comparison,
    Round,
    StopReason,
    Verdict,
    admitted_labels,
)
from spiral.types.system import has_coordinates

LIKELIHOOD_RATIO_T = "standard_errors"
"""Key of a round's details: by effect, |t| by the likelihood ratio to the model without it."""
MOST_AT_RANDOM = 0.5  # of the machine's own forces, and of its motion

_VERDICTS = {
    "effect_missing": "An effect is missing.",
    "nothing_missing": "Nothing is missing",
    "not_identifiable": "This record cannot tell the effects of the model apart.",
    "unknown_structure": "Something is missing that no known effect explains",
}


def reasons_for_doubt(last: Round, label: str, settings: Settings) -> str:
    """Why the model of a round does not determine one of its effects; empty where it does.

    Amplitudes with a standard error are asked; an effect that was not fitted is as it was given.
    Where the likelihood without the effect was asked, that counts in place of standard errors.
    """
    told = last.details.get(LIKELIHOOD_RATIO_T, {}).get(label, 0.0)
    return _amplitude_doubts(last.comparison.model, label, settings, told)


def _amplitude_doubts(model: Model, label: str, settings: Settings, told: float = 0.0) -> str:
    """As ``reasons_for_doubt``; ``told`` is |t| by a likelihood ratio, zero for none asked."""
    table = model.estimates().get(label, {})
    reasons: list[str] = []
    for key, parameter in model.pairs:
        owner, name = split_key(key)
        if owner != label or parameter.role != "amplitude" or (t := table[name].t) is None:
            continue
        value = table[name].estimate
        if parameter.at_bound(value):
            reasons.append(f"{name} lies at its bound of {number(value)}")
        elif not max(abs(t), told) >= settings.least_t:
            reasons.append(f"{name} is {number(abs(t), 2)} standard errors from zero")
        else:
            return ""
    return " and ".join(reasons)


def undetermined_effects(model: Model, added: Sequence[str], settings: Settings) -> tuple[str, ...]:
    """Those of the ``added`` effects of whose values a record tells none by its standard error.

    A record may be far less likely without such an effect: something is needed there, which other
    values, or another law, would do as well.
    """
    return tuple(x for x in added if _amplitude_doubts(model, x, settings))


def determined_effects(rounds: Sequence[Round], settings: Settings) -> tuple[str, ...]:
    """Admitted effects that the final model still has and determines (see the module)."""
    return tuple(
        x for x in admitted_labels(rounds) if not reasons_for_doubt(rounds[-1], x, settings)
    )


def missing_effects(rounds: Sequence[Round], settings: Settings) -> tuple[str, ...]:
    """The effects that were missing: determined ones, where they lower the error on unseen data.

    Where what is left has memory, effects that give way to it have only stood in for it; so have
    those in whose place one curve makes the record more likely, and those that explain little of
    what is left unexplained. A model that predicts nothing of an unseen record names nothing.
    """
    doubted = (
        _has_error_grown(rounds, settings)
        or _is_replaced_by_curve(rounds)
        or _explain_little(rounds, settings)
    )
    if doubted or predicts_nothing(rounds[-1].comparison, settings):
        return ()
    return tuple(
        x for x in determined_effects(rounds, settings) if x not in memory_stand_ins(rounds)
    )


def _explain_little(rounds: Sequence[Round], settings: Settings) -> bool:
    """Whether much is left unexplained, and what was admitted takes little of it.

    Much is left where there are ``shortfalls``, or where random forces are to explain an error of
    free runs that is larger than the noise. Little is ``settings.smallest`` or less of that error
    on unseen data, where it is not carried away; beside forces little is what ``takes_little``
    says, also some time ahead; but where a test hardly moves, so that its error had less than the
    noise to fall, free runs of the fitted records tell. Beside random forces of more than
    ``MOST_AT_RANDOM`` of the machine's own that make as much of a free run, what moves it is not
    known. Of a state that follows at once the rate is small, and a small force much beside it.
    """
    first, last = rounds[0].comparison, rounds[-1].comparison
    if len(rounds) < 2:
        return False
    alone, largest = is_moved_unseen(last), max(random_forces(last).values(), default=0.0)
    if min(largest, last.disturbed) > MOST_AT_RANDOM and not alone:
        return True
    if is_free_run_carried_away(last):
        return False
    if shortfalls(last, settings):
        return last.test_error > (1 - settings.smallest) * first.test_error
    if leaves_less_than_noise(last.test_error, last, settings):
        return False
    still = leaves_less_than_noise(first.test_error, last, settings)
    if still and takes_most(first.fit_error, last.fit_error):
        return False
    fallen = [(c.before, c.after) for c in changes(first.unseen, last.unseen)]
    fallen.append((first.test_error, last.test_error))
    return all(takes_little(before, after) for before, after in fallen)


def _is_replaced_by_curve(rounds: Sequence[Round]) -> bool:
    """Whether one learned curve explains more than the effects that were admitted do together."""
    return bool(rounds[-1].details.get("unknown", {}).get("replaces"))


def _has_error_grown(rounds: Sequence[Round], settings: Settings) -> bool:
    """Whether the error on unseen data grew over the study.

    It has not where it lies within what noise makes of it before and after: then it cannot fall,
    and chance alone decides which is larger. Growth by ``settings.smallest`` of what it was is one
    that a user sees, whatever acts at random; only where a free run is carried away it tells
    nothing.
    """
    first, last = rounds[0].comparison, rounds[-1].comparison
    if len(rounds) < 2 or last.test_error <= first.test_error:
        return False
    if is_error_unexplained(last, settings) or not last.unseen:
        return True
    least = (1 + settings.smallest) * max(first.test_error, first.noise_floor)
    if last.test_error > least and not is_free_run_carried_away(last):
        return True
    return unexplained_error_growth(first, last, settings) is not None


# --- verdicts ------------------------------------------------------------------------------------


def study_verdict(rounds: Sequence[Round], stopped: StopReason, settings: Settings) -> Verdict:
    """The verdict on the seed after a study: ``effect_missing`` where it found one.

    Where it admitted effects of which none is determined, or which raise the error on unseen data,
    or only stand in for memory, something is missing and nothing explains it. Where all were let go
    again, beside other noise, the model is the seed.
    """
    if stopped == "not_identifiable" or not admitted_labels(rounds):
        return seed_verdict(rounds[-1], stopped, settings)
    named = "unknown" not in rounds[0].details and missing_effects(rounds, settings)
    return "effect_missing" if named else "unknown_structure"


def seed_verdict(
    seed: Round, stopped: StopReason, settings: Settings, proposed: bool = False
) -> Verdict:
    """The verdict on a seed, which ``diagnose`` gives; ``proposed``: an effect passed the gates.

    ``nothing_missing`` needs no candidate passing *and* a model near its noise whose parameters the
    record tells apart; candidates exhausted while it is not near is ``unknown_structure``, also
    where a learned curve went on.
    """
    if stopped == "not_identifiable":
        return "not_identifiable"
    if proposed and "unknown" not in seed.details:
        return "effect_missing"
    if stopped == "diverged" or {"unknown", "memory"} & set(seed.details):
        return "unknown_structure"
    near = is_near_noise(seed.comparison, settings)
    if near and has_tied_effects(seed.details):
        return "not_identifiable"
    told = near and not is_undecided(seed.comparison, stopped, settings)
    return "nothing_missing" if told else "unknown_structure"


# --- words ---------------------------------------------------------------------------------------


def verdict_sentence(verdict: Verdict, comparison: Comparison, settings: Settings) -> str:
    """A verdict on one model with its figures."""
    words = _VERDICTS[verdict]
    if words.endswith("."):
        return words
    random = " ".join(filter(None, (random_sentence(comparison), record_sentence(comparison))))
    reasons = shortfalls(comparison, settings)
    untold = not reasons and is_free_run_telling_little(comparison, settings)
    if verdict == "nothing_missing" or untold:
        if untold:
            words = UNTOLD
        elif random_forces(comparison) and comparison.disturbed > comparison.noise_floor:
            unseen = "moves it, which no input tells" if is_moved_unseen(comparison) else ""
            words = f"Nothing is missing but what {unseen or 'acts at random'}"
        return f"{words}: {figures_clause(comparison, settings)}.{' ' + random if random else ''}"
    if (
        len(reasons) == 1
        and not comparison.test_error <= comparison.fit_error
        and _explains_fitted(comparison, settings)
    ):
        return (
            f"The model explains what it was fitted to, but not the test record: {reasons[0]}. "
            "Was the test made on another machine or setting, or does it contain motions that the "
            "fitted record does not?"
        )
    if reasons and not shortfalls(comparison, replace(settings, random_limit=float("inf"))):
        words = RANDOM_OR_MISSING
    told = f"{words}: {'; '.join(reasons)}." if reasons else f"{words}."
    return " ".join(filter(None, (told, random, _slow_force_sentence(comparison, settings))))


def _slow_force_sentence(comparison: Comparison, settings: Settings) -> str:
    """What a large random flow that lasts may be, where memory is not looked for; else empty."""
    large = {k for k, v in random_forces(comparison).items() if v > settings.random_limit}
    if has_coordinates(comparison.model.system) or not large & {*comparison.random_times}:
        return ""
    return (
        "A flow that lasts so long may be a state that the model lacks: several stores, or "
        "hysteresis (a candidate is a single store; other memory is looked for in forces alone)."
    )


def _explains_fitted(comparison: Comparison, settings: Settings) -> bool:
    """Whether what was fitted is explained, whatever the test record says."""
    explained = max(random_forces(comparison).values(), default=0.0) <= settings.random_limit
    return (
        explained
        and not comparison.contradictions
        and evidence_chi2(comparison) <= settings.chi2_limit
        and is_residual_white(comparison, settings)
    )


def study_summary(
    rounds: Sequence[Round], verdict: Verdict, stopped: StopReason, settings: Settings
) -> str:
    """What a study found, with its figures, in sentences for a report."""
    admitted, last = admitted_labels(rounds), rounds[-1].comparison
    if not admitted:
        if stopped == "diverged":
            return "The fit diverged."
        if stopped == "max_seconds":
            return _unfinished_sentence(last, settings)
        return seed_sentence(verdict, rounds, settings)
    if _is_replaced_by_curve(rounds):
        return _curve_summary(rounds, admitted)
    said = [_change_sentence(rounds, admitted, settings)]
    said += [
        f"This record does not determine {label}: {doubt}."
        for label in admitted
        if (doubt := reasons_for_doubt(rounds[-1], label, settings))
    ]
    said += [
        memory_sentence(rounds),
        describe_held_parameters(rounds[0].details, rounds[-1].details),
        describe_undetermined_parameters(rounds[-1].details),
    ]
    said.append(_remainder_sentence(last, settings))
    if stopped == "max_seconds":
        said.append(search_end_sentence(settings))
    return " ".join(filter(None, [*said, random_sentence(last), record_sentence(last)]))


def _remainder_sentence(comparison: Comparison, settings: Settings) -> str:
    """What a model leaves that is more than noise; empty where nothing is."""
    reasons = shortfalls(comparison, settings)
    more = "More is missing" if comparison.converged else "Whether more is missing cannot be told"
    return f"{more}: {'; '.join(reasons)}." if reasons else ""


def search_end_sentence(settings: Settings) -> str:
    """That the search ended for want of time."""
    return f"The search ended after {number(settings.seconds)} s, before all candidates were tried."


def _unfinished_sentence(comparison: Comparison, settings: Settings) -> str:
    """What is known of a seed when the search ended for want of time."""
    return f"{search_end_sentence(settings)} {_unconfirmed_sentence(comparison, settings)}"


def _unconfirmed_sentence(comparison: Comparison, settings: Settings) -> str:
    """That nothing was confirmed yet, and what speaks against the model as it is."""
    reasons = shortfalls(comparison, settings)
    said = f" Something is missing: {'; '.join(reasons)}." if reasons else ""
    return f"No candidate was confirmed until then.{said}"


def interrupted_summary(rounds: Sequence[Round], settings: Settings) -> str:
    """What a study knows that was stopped in the middle of its search, in sentences."""
    last = rounds[-1].comparison
    if not (admitted := admitted_labels(rounds)):
        return _unconfirmed_sentence(last, settings)
    change = _change_sentence(rounds, admitted, settings)
    return f"{change} {_remainder_sentence(last, settings)}".strip()


def _change_sentence(rounds: Sequence[Round], admitted: tuple[str, ...], settings: Settings) -> str:
    """What the admitted effects did to the error on unseen data."""
    first, last = rounds[0].comparison, rounds[-1].comparison
    change = error_clause(first, last)
    them = "it" if len(admitted) == 1 else "them"
    if _has_error_grown(rounds, settings):
        return (
            f"The model now contains {', '.join(admitted)}, but on data that no fit has seen the "
            f"error grew: {change}. Do not take {them} for what is missing."
        )
    change += growth_excuse(first, last)
    if predicts_nothing(last, settings):
        return (
            f"The model now contains {', '.join(admitted)}, and predicts nothing of data that no "
            f"fit has seen: {change}. Do not take {them} for what is missing."
        )
    named, doubtful = missing_effects(rounds, settings), memory_stand_ins(rounds)
    if doubtful and not named:
        return (
            f"{_VERDICTS['unknown_structure']}. The model now contains {', '.join(admitted)}, "
            f"which may only stand in for it: {change}."
        )
    if not named and _explain_little(rounds, settings):
        explains = "explains" if len(admitted) == 1 else "explain"
        words = _VERDICTS["unknown_structure"] if shortfalls(last, settings) else UNTOLD
        return (
            f"{words}. The model now contains {', '.join(admitted)}, which {explains} little of "
            f"it: {change}."
        )
    if not named:
        return f"The model now contains {', '.join(admitted)}: {change}."
    said = _missing_sentence(rounds, named, change, settings)
    if doubtful:
        names = ", ".join(doubtful)
        said += f" The model also contains {names}, which may only stand in for memory."
    return said


def _missing_sentence(
    rounds: Sequence[Round], named: tuple[str, ...], change: str, settings: Settings
) -> str:
    """What was missing, and what it did to the error; what is smaller than the noise comes last."""
    before, small = _smaller_than_noise(rounds, named, settings)
    main = tuple(x for x in named if x not in small)
    if main and small:
        change = error_clause(rounds[0].comparison, before)
    was, least_t = "was" if len(main or named) == 1 else "were", settings.least_t
    said = f"Missing {was} {name_effects(rounds, main or named, least_t)}: {change}."
    if main and small:
        names = name_effects(rounds, small, least_t)
        change = error_clause(before, rounds[-1].comparison)
        said += f" Missing too, and smaller than the noise: {names}; {change}."
    elif small:
        said += " What that does is smaller than the noise."
    return f"{said} At this size a name may stand for something else." if small else said


def _smaller_than_noise(
    rounds: Sequence[Round], named: tuple[str, ...], settings: Settings
) -> tuple[Comparison, tuple[str, ...]]:
    """The model after which an error has less than the noise left to fall, and what came then.

    Nothing came where no model is as near, or where no free run tells. What takes the place of an
    effect that came before does that effect's work.
    """
    last = rounds[-1].comparison
    errors = enumerate(r.comparison.test_error for r in rounds)
    near = (k for k, error in errors if leaves_less_than_noise(error, last, settings))
    k = next(near, len(rounds) - 1)
    early = {x for r in rounds[: k + 1] for x in r.admitted}
    for r in rounds[k + 1 :]:
        early |= set(r.admitted) if early & set(r.retired) else set()
    return rounds[k].comparison, tuple(x for x in named if x not in early)


def _curve_summary(rounds: Sequence[Round], admitted: tuple[str, ...]) -> str:
    """A curve that explains more than what was admitted: what it does to the unseen error."""
    first, last, shape = rounds[0].comparison, rounds[-1].comparison, rounds[-1].details["unknown"]
    what = shape["sentence"].partition(":")[0]
    stands = "stands" if len(admitted) == 1 else "stand"
    return (
        f"{_VERDICTS['unknown_structure']}: {what[:1].lower()}{what[1:]}. One curve brings the "
        f"test error from {percent(first.test_error)} to {percent(shape['test_error'])} (noise "
        f"floor {percent(shape['noise_floor'])}). The model now contains {', '.join(admitted)}, "
        f"which only {stands} in for it: {percent(last.test_error)}{_equal_curve_clause(rounds)}."
    )


def _equal_curve_clause(rounds: Sequence[Round]) -> str:
    """Why the names do not count where one curve explains as much; empty where it explains more."""
    unsure = rounds[-1].details["unknown"].get("undetermined", ())
    if not unsure:
        return ""
    return f", and the record determines no value of {', '.join(unsure)}"


def seed_sentence(verdict: Verdict, rounds: Sequence[Round], settings: Settings) -> str:
    """The verdict in words on a model to which nothing was added."""
    seed, held = rounds[-1].comparison, describe_held_parameters(rounds[0].details)
    if held and verdict == "not_identifiable":
        return f"{held} Beside that, nothing is missing: {figures_clause(seed, settings)}."
    about = verdict_sentence(verdict, seed, settings)
    return " ".join(filter(None, (about, memory_sentence(rounds), held)))


def noise_sentence(comparison: Comparison, settings: Settings) -> str:
    """The noise level found, where it contradicts the declared one; empty where it does not."""
    factor = noise_factor(comparison, settings)
    if factor == 1.0:
        return ""
    stated = "the record declares" if comparison.noise_ratio is not None else "was estimated"
    return (
        f"The noise is {number(factor, 2)} times what {stated}: what is left is white and of that "
        "size. Correct record.noise; standard errors here are for the noise that was seen."
        if factor > 1
        else f"The noise is only {number(factor, 2)} times what {stated}: what is left is smaller. "
        "Correct record.noise; standard errors here are too large."
    )

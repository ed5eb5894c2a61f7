"""Verdicts: what the figures of a study amount to, and what to do next.

A model is *near its noise* where all of these hold:

    1 / L <= chi2 / dof <= L          on the samples that were fitted,
    p >= level or Q / N <= s^2        what is left is white, or its colour harmless,
    (test error)^2 <= L (floor)^2 + 4 d^2     on samples that no fit has seen,

with L = ``chi2_limit``, s = ``smallest``, p and Q of Ljung and Box, d what the fitted random forces
are expected to make of a free run (``engine.likelihood.free_spread``; a record has few stretches
that are independent of one another, so that twice as much is no wonder). Q/N is about the share of
what is left that its own past predicts: below s^2 it is smaller than the smallest effect that
counts. Where a filter's likelihood is the evidence chi2 is that of the innovations; with
``strategy=innovation`` the test error is not asked: process noise moves what runs freely.

An admitted effect is *determined* where one of its amplitudes has |t| >= ``least_t`` and does not
lie at a bound. Only such an effect is named as what was missing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spiral.inference.acting import (
    coloured_noise,
    random_forces,
    random_of,
    random_sentence,
    record_sentence,
)
from spiral.inference.identifiability.held import effects_tied, held_said
from spiral.inference.problem import Settings
from spiral.inference.unknown.memory import forgotten, memory_said
from spiral.types.formatting import number, percent
from spiral.types.horizon import changes
from spiral.types.model import Model
from spiral.types.run import Comparison, Round, Stopped, Verdict

_STRETCHES = 4.0  # times the variance that random forces are expected to make of one free run
_AT_FLOOR = 1.2  # times the noise floor: within what is known of it

_VERDICTS = {
    "effect_missing": "An effect is missing.",
    "nothing_missing": "Nothing is missing",
    "not_identifiable": "This record cannot tell the effects of the model apart.",
    "unknown_structure": "Something is missing that no known effect explains",
}


# --- figures -------------------------------------------------------------------------------------


def white(found: Comparison, settings: Settings) -> bool:
    """Whether what is left is white, or its colour harmless.

    It is where it is smaller than any effect, or where it belongs to a sensor whose noise is not
    white: no random force acts, and the free run is as near to the record as that noise lets it.
    """
    small = found.whiteness_effect <= settings.smallest**2
    if found.whiteness_p >= settings.whiteness_level or small:
        return True
    at_floor = found.test_error <= _AT_FLOOR * found.noise_floor
    return bool(coloured_noise(found)) and at_floor and not random_forces(found)


def chi2_of(found: Comparison) -> float:
    """Chi2 per degree of freedom in the currency of the evidence: innovations, or windows."""
    chi2 = found.innovation_chi2
    return found.chi2_per_dof if chi2 is None else chi2


def noise_factor(found: Comparison, settings: Settings) -> float:
    """The noise over what the record says of it; 1 where the two do not contradict one another.

    What is left is white, and as large as the model-free estimate of the noise (or smaller than
    the noise is said to be): then it is the noise, and the statement is off.
    """
    chi2, limit = chi2_of(found), settings.chi2_limit
    if found.random is not None:  # the noise was fitted: its size against what is declared
        fitted = found.noise_ratio or 1.0
        return 1.0 if 1 / limit <= fitted**2 <= limit else fitted
    if not white(found, settings) or not np.isfinite(chi2) or 1 / limit <= chi2 <= limit:
        return 1.0
    seen = found.noise_ratio
    agrees = seen is not None and 1 / limit <= chi2 / seen**2 <= limit
    return float(np.sqrt(chi2)) if chi2 < 1 / limit or agrees else 1.0


def shortfalls(found: Comparison, settings: Settings) -> tuple[str, ...]:
    """Why a model is not near its noise, one phrase with its figure for each reason."""
    limit = settings.chi2_limit
    factor = _factor(found, settings)
    reasons = []
    if not found.converged:
        where = "" if found.random is not None else f" on windows of {found.horizon} samples"
        reasons.append(f"the fit did not converge{where}")
    if not chi2_of(found) <= limit * factor**2:
        reasons.append(f"chi2 per degree of freedom is {number(chi2_of(found))}, noise is 1")
    if not white(found, settings):
        share = percent(min(found.whiteness_effect, 1.0))
        reasons.append(f"what is left is not white (its past predicts about {share} of it)")
    forces = random_forces(found)
    if forces and max(forces.values()) > settings.random_limit:
        share = percent(max(forces.values()))
        reasons.append(
            f"beside it a random force of {share} of the machine's own would have to act"
        )
    for name, share in coloured_noise(found).items():
        if share > settings.noise_limit:
            where = name.partition(".")[2]
            reasons.append(f"the noise of {where} would be {percent(share)} of what it shows")
    if _errs(found, settings):
        made = percent(float(np.hypot(_floor(found, settings), _carried(found))))
        reasons.append(f"the test error is {percent(found.test_error)} where noise makes {made}")
    return tuple(reasons)


def _factor(found: Comparison, settings: Settings) -> float:
    return 1.0 if found.random is not None else noise_factor(found, settings)


def _floor(found: Comparison, settings: Settings) -> float:
    """The error of a free run that noise of the sensors alone makes."""
    return float(np.hypot(_factor(found, settings) * found.noise_floor, _drifting(found)))


def _carried(found: Comparison) -> float:
    """What random forces, and values and starts that are uncertain, make of a free run's error."""
    return float(np.hypot(found.disturbed, found.uncertain))


def _errs(found: Comparison, settings: Settings) -> bool:
    """Whether the error on unseen data is larger than noise, and what it carries on, make it.

    It is not asked where random forces were not modelled: they move what runs freely.
    """
    if found.innovation_chi2 is not None and found.random is None:
        return False
    floor = _floor(found, settings)
    allowed = settings.chi2_limit * floor**2 + _STRETCHES * _carried(found) ** 2
    return not found.test_error**2 <= allowed


def _drifting(found: Comparison) -> float:
    """What drifting sensors add to the error of a free run: rms of their shares over channels."""
    shares = random_of(found, "drift").values()
    return float(np.sqrt(sum(v**2 for v in shares) / max(len(found.channels), 1)))


def near_noise(found: Comparison, settings: Settings) -> bool:
    """Whether the noise explains all that a model leaves, on seen and unseen samples."""
    return not shortfalls(found, settings)


def doubts(model: Model, label: str, settings: Settings) -> str:
    """Why a fitted model does not determine one of its effects; empty where it does.

    Amplitudes with a standard error are asked; an effect that was not fitted is as it was given.
    """
    table = model.estimates().get(label, {})
    reasons: list[str] = []
    for key, parameter in model.pairs:
        owner, name = key.rsplit(".", 1)
        if owner != label or parameter.role != "amplitude" or (t := table[name].t) is None:
            continue
        value = table[name].estimate
        if parameter.at_bound(value):
            reasons.append(f"{name} lies at its bound of {number(value)}")
        elif not abs(t) >= settings.least_t:
            reasons.append(f"{name} is {number(abs(t), 2)} standard errors from zero")
        else:
            return ""
    return " and ".join(reasons)


def determined(rounds: Sequence[Round], settings: Settings) -> tuple[str, ...]:
    """Effects admitted and still held that the final model determines."""
    model = rounds[-1].comparison.model
    return tuple(x for x in _admitted(rounds) if not doubts(model, x, settings))


def missing(rounds: Sequence[Round], settings: Settings) -> tuple[str, ...]:
    """The effects that were missing: determined ones, where they lower the error on unseen data.

    Where what is left has memory, effects without any may only have stood in for it; so have those
    in whose place one curve makes the record more likely. A model that predicts nothing of an
    unseen record names nothing.
    """
    doubted = _worse(rounds, settings) or forgotten(rounds) or _replaced(rounds)
    doubted = doubted or _predicts_nothing(rounds[-1].comparison, settings)
    return () if doubted else determined(rounds, settings)


def _predicts_nothing(found: Comparison, settings: Settings) -> bool:
    """Whether a free run on unseen data errs by all that moves there, more than noise explains."""
    return not found.test_error < 1.0 and _errs(found, settings)


def _replaced(rounds: Sequence[Round]) -> bool:
    """Whether one learned curve explains more than the effects that were admitted do together."""
    return bool(rounds[-1].details.get("unknown", {}).get("replaces"))


def _admitted(rounds: Sequence[Round]) -> tuple[str, ...]:
    held = rounds[-1].comparison.model.labels
    return tuple(dict.fromkeys(x for r in rounds for x in r.admitted if x in held))


def _worse(rounds: Sequence[Round], settings: Settings) -> bool:
    """Whether the error on unseen data grew over the study.

    It has not where it lies within what noise makes of it before and after: then it cannot fall,
    and chance alone decides which is larger.
    """
    first, last = rounds[0].comparison, rounds[-1].comparison
    if len(rounds) < 2 or last.test_error <= first.test_error:
        return False
    judged = [c.judged for c in changes(first.unseen, last.unseen)]
    return _errs(last, settings) or not judged or "worse" in judged


# --- verdicts ------------------------------------------------------------------------------------


def study_verdict(rounds: Sequence[Round], stopped: Stopped, settings: Settings) -> Verdict:
    """The verdict on the seed after a study: ``effect_missing`` where it found one.

    Where it admitted effects of which none is determined, or which raise the error on unseen data,
    something is missing and nothing explains it; likewise where the rest has memory and they none.
    """
    if stopped != "not_identifiable" and len(rounds) > 1 and "unknown" not in rounds[0].details:
        return "effect_missing" if missing(rounds, settings) else "unknown_structure"
    return seed_verdict(rounds[0], stopped, settings)


def seed_verdict(
    seed: Round, stopped: Stopped, settings: Settings, proposed: bool = False
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
    if near_noise(seed.comparison, settings):
        return "not_identifiable" if effects_tied(seed.details) else "nothing_missing"
    return "unknown_structure"


# --- words ---------------------------------------------------------------------------------------


def verdict_sentence(verdict: Verdict, found: Comparison, settings: Settings) -> str:
    """A verdict on one model with its figures."""
    words = _VERDICTS[verdict]
    if words.endswith("."):
        return words
    random = " ".join(filter(None, (random_sentence(found), record_sentence(found))))
    if verdict == "nothing_missing":
        return f"{words}: {_figures(found, settings)}.{' ' + random if random else ''}"
    reasons = shortfalls(found, settings)
    if len(reasons) == 1 and not found.test_error <= found.fit_error and _fits(found, settings):
        return (
            f"The model explains what it was fitted to, but not the test record: {reasons[0]}. "
            "Another machine or setting, or motions that the fitted record does not hold?"
        )
    told = f"{words}: {'; '.join(reasons)}." if reasons else f"{words}."
    return f"{told} {random}".strip()


def _fits(found: Comparison, settings: Settings) -> bool:
    """Whether what was fitted is explained, whatever the test record says."""
    return chi2_of(found) <= settings.chi2_limit and white(found, settings)


def _figures(found: Comparison, settings: Settings) -> str:
    floor = percent(found.noise_floor)
    error = f"the test error is {percent(found.test_error)} (noise floor {floor})"
    if found.random is not None:
        kind = "white noise" if found.whiteness_p >= settings.whiteness_level else "noise"
        return f"what is left is {kind}, and {error}"
    return (
        f"chi2 per degree of freedom is {number(chi2_of(found), 3)}, what is left is white, "
        f"and {error}"
    )


def summary(rounds: Sequence[Round], verdict: Verdict, stopped: Stopped, settings: Settings) -> str:
    """What a study found, with its figures, in sentences to be signed."""
    admitted = _admitted(rounds)
    last = rounds[-1].comparison
    if not admitted:
        if stopped == "diverged":
            return "The fit diverged."
        return seed_said(verdict, rounds, settings)
    if _replaced(rounds):
        return _in_place(rounds, admitted)
    said = [_change(rounds, admitted, settings)]
    said += [
        f"This record does not determine {label}: {doubt}."
        for label in admitted
        if (doubt := doubts(last.model, label, settings))
    ]
    said += [memory_said(rounds), held_said(rounds[0].details)]
    if reasons := shortfalls(last, settings):
        more = "More is missing" if last.converged else "Whether more is missing cannot be told"
        said.append(f"{more}: {'; '.join(reasons)}.")
    return " ".join(filter(None, [*said, random_sentence(last), record_sentence(last)]))


def _change(rounds: Sequence[Round], admitted: tuple[str, ...], settings: Settings) -> str:
    """What the admitted effects did to the error on unseen data."""
    first, last = rounds[0].comparison, rounds[-1].comparison
    change = (
        f"test error {percent(first.test_error)} -> {percent(last.test_error)} "
        f"(noise floor {percent(last.noise_floor)})"
    )
    them = "it" if len(admitted) == 1 else "them"
    if _worse(rounds, settings):
        return (
            f"The model now holds {', '.join(admitted)}, but on data that no fit has seen the "
            f"error grew: {change}. Do not take {them} for what is missing."
        )
    if _predicts_nothing(last, settings):
        return (
            f"The model now holds {', '.join(admitted)}, and predicts nothing of data that no fit "
            f"has seen: {change}. Do not take {them} for what is missing."
        )
    if forgotten(rounds):
        return (
            f"{_VERDICTS['unknown_structure']}. The model now holds {', '.join(admitted)}, which "
            f"may only stand in for it: {change}."
        )
    named = determined(rounds, settings)
    if not named:
        return f"The model now holds {', '.join(admitted)}: {change}."
    return f"Missing {'was' if len(named) == 1 else 'were'} {', '.join(named)}: {change}."


def _in_place(rounds: Sequence[Round], admitted: tuple[str, ...]) -> str:
    """A curve that explains more than what was admitted: what it does to the unseen error."""
    first, last, shape = rounds[0].comparison, rounds[-1].comparison, rounds[-1].details["unknown"]
    what = shape["sentence"].partition(":")[0]
    stands = "stands" if len(admitted) == 1 else "stand"
    return (
        f"{_VERDICTS['unknown_structure']}: {what[:1].lower()}{what[1:]}. One curve brings the "
        f"test error from {percent(first.test_error)} to {percent(shape['test_error'])} (noise "
        f"floor {percent(shape['noise_floor'])}). The model now holds {', '.join(admitted)}, which "
        f"only {stands} in for it: {percent(last.test_error)}."
    )


def seed_said(verdict: Verdict, rounds: Sequence[Round], settings: Settings) -> str:
    """What was found of a model to which nothing was added."""
    seed, held = rounds[0].comparison, held_said(rounds[0].details)
    if held and verdict == "not_identifiable":
        return f"{held} Beside that, nothing is missing: {_figures(seed, settings)}."
    about = verdict_sentence(verdict, seed, settings)
    return " ".join(filter(None, (about, memory_said(rounds), held)))


def noise_sentence(found: Comparison, settings: Settings) -> str:
    """What the noise is where the record says otherwise; empty where it does not."""
    factor = noise_factor(found, settings)
    if factor == 1.0:
        return ""
    stated = "the record declares" if found.noise_ratio is not None else "was estimated"
    return (
        f"The noise is {number(factor, 2)} times what {stated}: what is left is white and of that "
        "size. Correct record.noise; standard errors here are for the noise that was seen."
        if factor > 1
        else f"The noise is only {number(factor, 2)} times what {stated}: what is left is smaller. "
        "Correct record.noise; standard errors here are too large."
    )

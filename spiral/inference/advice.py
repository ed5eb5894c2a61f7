"""Advice after a study: what to do next, in one or two sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from spiral.inference.disturbances import random_forces, what_acts
from spiral.inference.nearness import is_free_run_telling_little, is_moved_unseen, is_near_noise
from spiral.inference.problem import Settings
from spiral.inference.unknown.memory import memory_sentence
from spiral.inference.verdict import noise_sentence
from spiral.types.formatting import capitalised, percent
from spiral.types.run import Comparison, Round, StopReason, Verdict

_FOR_MEMORY = (
    "Offer effects with states of their own (bouc_wen, jenkins, lag) as candidates, or write one "
    "(spiral new effect NAME)."
)
_FOR_OTHER_MOTION = (
    "Record what drives the machine as well, or move it more by what is recorded: most of this "
    "motion came from elsewhere."
)
_FOR_UNKNOWN = (
    "See where the residual is large with `spiral diagnose`, and add an effect of your own (a file "
    "in ./plugins)."
)


def advice_for(
    verdict: Verdict,
    stopped: StopReason,
    rounds: Sequence[Round],
    groups: tuple[tuple[str, ...], ...],
    settings: Settings,
) -> str:
    """One or two sentences: what to do next."""
    if verdict == "not_identifiable":
        tied = "; ".join(" and ".join(g) for g in groups)
        return (
            (f"On this record {tied} look alike. " if tied else "")
            + "Hold one of them at its known value (fixed=[NAME]), or record a test that moves "
            "them differently: a start-up transient, other frequencies; with a rotor, sweep the "
            "speed through the resonance."
        )
    if stopped == "diverged":
        return (
            "The model diverged even on short windows. Check units and signs of the channels, or "
            "give start values with values='{...}'."
        )
    if stopped == "max_seconds":
        return "Give the search more time (settings.seconds), or fewer candidates."
    last = rounds[-1].comparison
    shape = next((r.details["unknown"] for r in reversed(rounds) if "unknown" in r.details), None)
    if shape is not None and stopped != "max_rounds" and "unknown" in rounds[-1].details:
        return _curve_advice(shape)
    if memory_sentence(rounds):
        return _FOR_MEMORY
    if is_free_run_telling_little(last, settings) and is_near_noise(last, settings):
        return _FOR_OTHER_MOTION
    if verdict == "unknown_structure" and len(rounds) == 1:
        return _FOR_UNKNOWN
    return " ".join(s for s in (_ending_sentence(verdict, stopped, last, settings),
                                noise_sentence(last, settings)) if s)  # fmt: skip


def _curve_advice(shape: Mapping[str, Any]) -> str:
    """What to do with a learned curve that explains what is left."""
    how = "settings.learned=true"
    if not shape.get("replaces"):
        how = f"spiral add {shape['effect']} run=latest, or {how}"
    floor = shape.get("noise_floor") or 0.0
    with_it = f"With it the test error is {percent(shape['test_error'])}" if floor else ""
    told = f"{with_it} (noise floor {percent(floor)}). " if with_it else ""
    return (
        f"Its shape: {shape['sentence']} {told}Admit the curve ({how}), or write the effect that "
        "it suggests."
    )


def _ending_sentence(
    verdict: Verdict, stopped: StopReason, last: Comparison, settings: Settings
) -> str:
    """Why the loop ended."""
    near, caveat = is_near_noise(last, settings), random_force_caveat(last, settings, "these")
    caveat = f" {caveat}" if caveat else ""
    random = f" and random {what_acts(last.model)}s"
    if verdict == "nothing_missing":
        beside = random if random_forces(last) else ""
        return f"The model explains this record down to its noise{beside}.{caveat}"
    if stopped == "max_rounds":
        return "The loop stopped at its largest number of rounds."
    if stopped == "no_candidate" or not near:
        return "No further candidate passes the gates."
    beside = random if caveat else ""
    return f"What is left is white noise{beside}.{caveat}"


def random_force_caveat(last: Comparison, settings: Settings, named: str = "") -> str:
    """What random forces mean that move a free run by more than the smallest effect that counts.

    The sentence begins with ``named``, or names them; it is empty where they move it by less.
    """
    if not random_forces(last) or not last.disturbed > settings.smallest:
        return ""
    named = named or f"random {what_acts(last.model)}s"
    if is_moved_unseen(last):
        return (
            f"{capitalised(named)} are all that moves the machine, since no input does; "
            "a record with one that is measured (a shaker, a step, the wind) tells far more."
        )
    much = "all" if last.disturbed >= 1.0 else percent(last.disturbed)
    return (
        f"{capitalised(named)} move a free run by {much} of the motion: if nothing "
        "shakes the machine so, something is missing that only looks random in this record; a "
        "longer or livelier one tells."
    )

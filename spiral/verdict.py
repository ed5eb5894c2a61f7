"""Verdicts and advice, in words a person can act on."""

from __future__ import annotations

from spiral.run import Round, Stopped, Verdict


def seed_verdict(rounds: list[Round], stopped: Stopped, level: float) -> Verdict:
    """The verdict on the seed: what ``diagnose`` would say of it.

    ``nothing_missing`` needs no candidate passing *and* white residuals; candidates exhausted
    while the residuals are coloured is ``unknown_structure``, also where a learned curve went on.
    """
    if stopped == "not_identifiable":
        return "not_identifiable"
    if stopped == "diverged" and len(rounds) == 1:
        return "unknown_structure"
    if "unknown" in rounds[0].details:
        return "unknown_structure"
    if len(rounds) > 1:
        return "effect_missing"
    return "nothing_missing" if rounds[0].comparison.whiteness_p >= level else "unknown_structure"


def advice_for(
    verdict: Verdict,
    stopped: Stopped,
    rounds: list[Round],
    groups: tuple[tuple[str, ...], ...],
) -> str:
    """One or two sentences: what to do next."""
    if verdict == "not_identifiable":
        tied = "; ".join(" = ".join(g) for g in groups)
        return (
            (f"Alike on it are {tied}. " if tied else "")
            + "Sweep the speed (run-up or coast-down) through the resonance, or record the "
            "start-up transient, and try again."
        )
    if stopped == "diverged":
        return (
            "The model diverged even on short windows. Check units and signs of the channels, or "
            "give starts with values='{...}'."
        )
    last = rounds[-1].comparison
    shape = next((r.details["unknown"] for r in reversed(rounds) if "unknown" in r.details), None)
    if shape is not None and stopped == "no_candidate" and "unknown" in rounds[-1].details:
        return (
            f"Its shape: {shape['sentence']} Admit the curve (spiral add {shape['effect']} "
            "run=latest, or settings.learned=true), or write the effect that it suggests."
        )
    if verdict == "unknown_structure":
        return (
            "See where the residual lives with `spiral diagnose`, and add an effect of your own "
            "(a file in ./plugins)."
        )
    if verdict == "nothing_missing":
        return "The model explains this record down to its noise."
    ending = {
        "whiteness": "What is left is white noise.",
        "no_candidate": "No further candidate passes the gates"
        + ("." if last.whiteness_p > 0.001 else ", though the residual is not quite white."),
        "max_rounds": "The loop stopped at its largest number of rounds.",
    }
    return ending.get(stopped, "")

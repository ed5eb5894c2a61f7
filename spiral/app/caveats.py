"""Caveats of a step: look-alikes, undetermined parameters, doubtful signs, random forces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spiral.inference.advice import random_force_caveat
from spiral.inference.discover import Checkpoint
from spiral.inference.problem import Settings
from spiral.inference.verdict import reasons_for_doubt
from spiral.physics.passivity import implausible_signs
from spiral.types.formatting import capitalised
from spiral.types.invalid import reading_step
from spiral.types.label import without_variant
from spiral.types.record import Record
from spiral.view.report.style import label_words

_DIGITS = 1e-5  # of a channel's deviation: the last of five digits


def indistinguishable_effects(at: Checkpoint) -> list[tuple[str, ...]]:
    """Tuples (effect of the turn's model, effects that the record cannot tell from it ...)."""
    held = at.rounds[-1].comparison.model.labels
    aliases = {k: v for one in at.rounds for k, v in one.aliases.items() if k in held and v}
    return [(label, *others) for label, others in aliases.items()]


def tellable_noise_floor(floor: float, records: Sequence[Record]) -> float | None:
    """The noise floor, and nothing where it is less than the rounding of the file would make.

    A reading in steps of q is off by q / 12^(1/2), whatever else its sensor does, and files of
    measurements have some five digits; as a share of the channel's deviation, the mean over
    channels, as the floor is.
    """
    channels = [values for record in records for values in record.channels.values()]
    steps = [np.nan_to_num(reading_step(v) / np.std(v)) / 12**0.5 for v in channels]
    return None if floor < max(float(np.mean(steps)), _DIGITS) else floor


def turn_caveats(at: Checkpoint, settings: Settings) -> list[str]:
    """Sentences that limit a turn's verdict: undetermined parameters first, then look-alikes."""
    from spiral.view.report.text import ambiguity_notes

    last = at.rounds[-1].comparison
    model = last.model
    sentences = [
        f"This record does not determine {label_words(label)}: {doubt}."
        for label in model.labels
        if (doubt := reasons_for_doubt(at.rounds[-1], label, settings))
    ]
    sentences += [
        f"{label_words(key.replace('.', ', '))}: {said}."
        for key, said in implausible_signs(model).items()
        if not any(c.startswith(f"{without_variant(key)} ") for c in last.contradictions)
    ]
    sentences += [f"{capitalised(said)}." for said in last.contradictions]
    sentences += filter(None, (random_force_caveat(last, settings),))
    for number, one in enumerate(at.rounds):
        kept = {k: v for k, v in one.aliases.items() if k in model.labels}
        lost = one.details.get("not_separable", {}) if number == len(at.rounds) - 1 else {}
        sentences += ambiguity_notes({"aliases": kept, "details": {"not_separable": lost},
                          "admitted": one.admitted, "second_order": one.second_order})  # fmt: skip
    return list(dict.fromkeys(sentences))

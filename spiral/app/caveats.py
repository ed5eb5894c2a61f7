"""What is to be held against a step: look-alikes, what its record leaves open, doubtful signs."""

from __future__ import annotations

from spiral.inference.discover import Checkpoint
from spiral.inference.problem import Settings
from spiral.inference.verdict import doubts
from spiral.physics.passivity import implausible
from spiral.view.report.style import words


def alike(at: Checkpoint) -> list[tuple[str, ...]]:
    """Each effect of a turn's model that others cannot be told from, before those others."""
    held = at.rounds[-1].comparison.model.labels
    found = {k: v for one in at.rounds for k, v in one.aliases.items() if k in held and v}
    return [(label, *others) for label, others in found.items()]


def caveats(at: Checkpoint, settings: Settings) -> list[str]:
    """What is to be held against a turn's verdict, in sentences, the model's own doubts first."""
    from spiral.view.report.text import doubted

    model = at.rounds[-1].comparison.model
    found = [
        f"This record does not determine {words(label)}: {doubt}."
        for label in model.labels
        if (doubt := doubts(at.rounds[-1], label, settings))
    ]
    found += [
        f"{words(key.replace('.', ', '))}: {said}." for key, said in implausible(model).items()
    ]
    for number, one in enumerate(at.rounds):
        kept = {k: v for k, v in one.aliases.items() if k in model.labels}
        lost = one.details.get("not_separable", {}) if number == len(at.rounds) - 1 else {}
        found += doubted({"aliases": kept, "details": {"not_separable": lost},
                          "admitted": one.admitted, "second_order": one.second_order})  # fmt: skip
    return list(dict.fromkeys(found))

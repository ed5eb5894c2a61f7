"""The suggestions of a round of the likelihood strategy, from scores and refits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import special

from spiral.inference.evidence.scoring import Ranking
from spiral.inference.likelihood.candidates import Rival
from spiral.inference.suggest import suggestions_by_evidence
from spiral.types.run import Suggestion

_WORST = 50.0  # logarithm of the growth of the misses' squares beyond which one is as bad as all


def suggestions(
    rivals: Sequence[Rival], ranking: Ranking, label: str, aliases: tuple[str, ...]
) -> tuple[Suggestion, ...]:
    """Suggestions: the admitted one, then those refitted by worth, then others by their score.

    Scores promise more than refits keep: the share that others explain is capped at the least of
    those refitted.
    """
    listed = {s.effect: s for s in suggestions_by_evidence(ranking, None, ())}
    tried: dict[str, Suggestion] = {}
    for rival in rivals:
        seen = listed.get(rival.label)
        tried.setdefault(rival.label, _as_suggestion(rival, seen.hint if seen else ()))
    least, net = (min((getattr(s, n) or 0.0 for s in tried.values()), default=1.0)
                  for n in ("explains", "net"))  # fmt: skip
    others = [
        replace(s, explains=min(s.explains, least), net=min(s.net or 0.0, net))
        for s in listed.values()
        if s.effect not in tried
    ]
    named = [*tried.values(), *others]
    named = [replace(s, aliases=aliases) if s.effect == label else s for s in named]
    return tuple(sorted(named, key=lambda s: s.effect != label))


def _as_suggestion(rival: Rival, hint: tuple[str, ...]) -> Suggestion:
    """A refitted candidate: twice its gain in log-likelihood, and the share of the innovations."""
    count = sum(p.misses.size for p in rival.fit.estimate.predictions) / 2  # the half that selects
    gain, terms = max(rival.gain, 0.0), len(rival.ranked.columns)
    p_value = float(special.chdtrc(terms, 2 * gain))
    return Suggestion(
        effect=rival.label, meaning=rival.ranked.variant.original.meaning(), aliases=(),
        p_value=p_value, statistic=2 * gain, wald_p_value=p_value, hint=hint,
        explains=_share_of_squares(gain, count), net=_share_of_squares(rival.worth, count),
    )  # fmt: skip


def _share_of_squares(gain: float, count: float) -> float:
    """Share of the squares that a gain explains: 1 - exp(-2 gain / count)."""
    return -float(np.expm1(np.clip(-2 * gain / count, None, _WORST)))


def sort_by_net(listed: Sequence[Suggestion]) -> tuple[Suggestion, ...]:
    """Suggestions by what each explains net of the price of its numbers, the most first."""
    return tuple(sorted(listed, key=lambda s: -(s.net or 0.0)))

"""What comes of testing candidates: models with them, which one passed, and why others did not."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from spiral.inference.evidence.assembly import Assembly
from spiral.inference.likelihood.candidates import Rival
from spiral.inference.likelihood.fitting import WORTH, LikelihoodFit
from spiral.inference.strategies.base import RefittedModel
from spiral.inference.strategies.likelihood.benefit import Refusal


@dataclass(frozen=True)
class WholeRecordFit:
    """A model fitted to all samples: the study it is compiled in, its fit, and its comparison.

    ``complete`` : whether its noise model was looked for, which is left out where that is no use.
    """

    assembly: Assembly
    fit: LikelihoodFit
    refitted: RefittedModel
    complete: bool = True


@dataclass(frozen=True)
class AcceptedCandidate:
    """A candidate that passed all tests, its look-alikes (``aliases``), and the model with it."""

    rival: Rival
    aliases: tuple[str, ...]
    whole: WholeRecordFit


Objection = Callable[[WholeRecordFit], Refusal | None]
"""Function that gives the reason to refuse a model with a candidate, or nothing."""


@dataclass(frozen=True)
class RaceOutcome:
    """The first winner of a race that passed all tests, and why earlier ones were refused.

    ``likely`` is the first that is more likely, also on the blocks that did not select, and was
    refused for what it does alone. ``worths`` of those rejected, on the blocks that select;
    ``refused`` are those of them that were fitted to the whole records, ``instead`` the first in
    whose place another interpolation of an input does as well: the model with that, without it.
    """

    passed: AcceptedCandidate | None
    rejected: dict[str, str]
    likely: AcceptedCandidate | None = None
    worths: Mapping[str, float] = field(default_factory=dict)
    refused: tuple[str, ...] = ()
    instead: RefittedModel | None = None

    def refused_on_whole(self) -> RaceOutcome:
        """What the whole records have refused, whatever it is worth in another race."""
        reasons = {x: self.rejected[x] for x in self.refused}
        return RaceOutcome(None, reasons, worths=dict.fromkeys(reasons, np.inf))

    def reason_for(self, rival: Rival) -> str:
        """Why a rival was rejected at the same maximum; empty where it was not.

        One that is worth no more than it was then has come to the values of that time.
        """
        if rival.worth > self.worths.get(rival.label, -np.inf) + WORTH:
            return ""
        return self.rejected.get(rival.label, "")

    @property
    def admitted(self) -> tuple[AcceptedCandidate, ...]:
        """The candidate that passed, as a tuple of one; empty where none did."""
        return () if self.passed is None else (self.passed,)


NOTHING_TRIED = RaceOutcome(None, {})

"""How inputs run between their samples, where no record says: the likelihood decides.

A force that a controller holds, that was recorded in few points, or that was made in straight lines
is another force between its samples than a smooth curve through them. What the difference does
looks like an actuator that lags or limits its rate.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import get_args

import numpy as np

from spiral.engine.likelihood.predict import all_predicted
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.likelihood.fitting import LikelihoodFit, refitted, subjects
from spiral.inference.problem import Problem, Progress
from spiral.types.parameter import BETWEEN, Input, Interpolation

Ways = Mapping[str, Interpolation]

ODDS = 100.0
"""To one, for which an input runs in another way than its system says."""
_SHOWN = 1.0  # squared change of the whitened misses from which a record can tell two ways apart


def with_likely_inputs(
    assembly: Assembly, found: LikelihoodFit, progress: Progress
) -> LikelihoodFit:
    """The fit with every input run between its samples in the way that is most likely.

    Asked for each input that no record declares and nothing else follows from. A way is fitted
    where the records could tell it from the present one: where it changes the whitened misses, in
    squares and summed, by one. The system's own way stands unless another is ``ODDS`` times as
    likely.
    """
    for known in assembly.problem.model.system.inputs:
        if not found.estimate.finite or not _open(assembly.problem, known):
            continue
        ways = [w for w in get_args(Interpolation) if w != _way(found, known)]
        fits = [found]
        for way in ways:
            state = replace(found.state, between=_with(found, known, way))
            if not _differs(assembly, found, replace(found, state=state)):
                continue
            progress(f"asking how {known.name} runs between its samples")
            fits.append(refitted(assembly, state, rough=True))
        found = max(fits, key=lambda f: f.height + _favour(f, known))
    return found


def told(between: Ways) -> Iterator[str]:
    """What was found, a sentence for each input."""
    for name, way in between.items():
        yield (
            f"with this model {name} is between its samples most likely {BETWEEN[way]} "
            f"(record.hold={way} would say so)"
        )


def _open(problem: Problem, known: Input) -> bool:
    declared = any(known.name in r.hold for r in (*problem.records, *problem.test))
    return not (declared or known.derivative or known.derived_from)


def _way(found: LikelihoodFit, known: Input) -> Interpolation:
    return found.state.between.get(known.name, known.interpolation)


def _with(found: LikelihoodFit, known: Input, way: Interpolation) -> Ways:
    """The ways of a fit with one more; the system's own need not be told."""
    others = {k: w for k, w in found.state.between.items() if k != known.name}
    return others if way == known.interpolation else {**others, known.name: way}


def _favour(found: LikelihoodFit, known: Input) -> float:
    return float(np.log(ODDS)) if _way(found, known) == known.interpolation else 0.0


def _differs(assembly: Assembly, found: LikelihoodFit, other: LikelihoodFit) -> bool:
    """Whether the same values and noise predict otherwise, by more than the records' noise."""
    at = found.estimate
    trial = all_predicted([(subjects(assembly, other.state), at.noise)])[0]
    if not all(p.whole for p in trial):
        return True
    changes = ((t.misses - p.misses) * p.weight for p, t in zip(at.parts, trial, strict=True))
    return sum(float(np.sum(c**2)) for c in changes) > _SHOWN

"""How near a model comes to its noise, and whether one predicts better than another.

A model is *near its noise* where all of these hold:

    1 / L <= chi2 / dof <= L          on the samples that were fitted,
    p >= level or (Q - m) / N <= s^2  what is left is white, or its colour harmless,
    (test error)^2 <= L (floor)^2 + 6.6 d^2   on samples that no fit has seen,

with L = ``chi2_limit``, s = ``smallest``, p and Q of Ljung and Box over m lags, d what the fitted
random forces are expected to make of a free run (``engine.likelihood.free_spread``; a record may be
one stretch of what they move slowly, and chi2 of one degree of freedom is 6.6 once in a hundred).
(Q - m) / N is about the share of what is left that its own past predicts: below s^2 it is smaller
than the smallest effect that counts. Colour is harmless, too, where up to a quarter of what is left
is told by its own past and less than s^2 by motion and inputs beside that
(``likelihood.independence``): it is the noise that is not quite as it was modelled. Where a
filter's likelihood is the evidence chi2 is that of the innovations; with ``strategy=innovation``
the test error is not asked: process noise moves what runs freely.
"""

from __future__ import annotations

import numpy as np

from spiral.inference.acting import coloured_noise, random_forces, random_of
from spiral.inference.problem import Settings
from spiral.types.formatting import number, percent
from spiral.types.horizon import Change, changes
from spiral.types.run import Comparison

_STRETCHES = 6.6  # times the variance that random forces are expected to make of one free run
LASTING = 0.1  # of a record, beyond which noise has few values in it
_HALF = 0.5  # of all that moves, missed one sample ahead: no model of a machine that runs away
_AT_FLOOR = 1.2  # times the noise floor: within what is known of it
_CHANCE = 2.0  # standard errors that an error ahead grows by chance once in forty
_COLOUR = 0.25  # share of what is left, half its deviation, up to which its own past may tell it


def white(found: Comparison, settings: Settings) -> bool:
    """Whether what is left is white, or its colour harmless.

    It is where it is smaller than any effect, or its own past alone tells it, neither motion nor
    inputs; or where it belongs to a sensor whose noise is not white: no random force acts, and the
    free run is as near to the record as that noise lets it.
    """
    small = found.whiteness_effect <= settings.smallest**2
    if found.whiteness_p >= settings.whiteness_level or small or own_colour(found, settings):
        return True
    at_floor = found.test_error <= _AT_FLOOR * found.noise_floor
    return bool(coloured_noise(found)) and at_floor and not random_forces(found)


def own_colour(found: Comparison, settings: Settings) -> bool:
    """Whether what is left has a colour that counts, and neither motion nor inputs explain it."""
    least = settings.smallest**2
    counts = found.whiteness_p < settings.whiteness_level and found.whiteness_effect > least
    alone = found.followed is not None and found.followed <= least
    return counts and alone and found.whiteness_effect <= _COLOUR


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
    if errs(found, settings) and runs_away(found):
        ahead = percent(next_sample(found) or 0.0)
        reasons.append(f"one sample ahead the error on unseen data is {ahead}")
    elif errs(found, settings):
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


def errs(found: Comparison, settings: Settings) -> bool:
    """Whether the error on unseen data is larger than noise, and what it carries on, make it.

    It is not asked where random forces were not modelled: they move what runs freely. Of a machine
    that ``runs_away`` the next sample is asked: half of all that moves may not be missed there.
    """
    if found.innovation_chi2 is not None and found.random is None:
        return False
    floor, drifting = _floor(found, settings), _drifting(found)
    if runs_away(found):
        ahead = next_sample(found)
        return ahead is not None and not ahead <= max(_HALF, 2 * floor)
    few = _carried(found) ** 2 + drifting**2  # of which a record has few values
    allowed = settings.chi2_limit * (floor**2 - drifting**2) + _STRETCHES * few
    return not found.test_error**2 <= allowed


def runs_away(found: Comparison) -> bool:
    """Whether what is at random, or uncertain, carries a free run as far as all that moves.

    As of a machine that only its controller holds: a free run is no witness of any model there.
    """
    return found.random is not None and not _carried(found) < 1.0


def next_sample(found: Comparison) -> float | None:
    """The error on unseen data one sample ahead; nothing where there are none."""
    return next((h.error for h in found.unseen if h.samples == 1), None)


def _drifting(found: Comparison) -> float:
    """What drifting sensors add to the error of a free run: rms of their shares over channels.

    Noise of a sensor that lasts long drifts as well.
    """
    lasts = LASTING * found.horizon * _sample(found)
    slow = {n: v for n, v in coloured_noise(found).items() if found.random_times.get(n, 0) > lasts}
    shares = (*random_of(found, "drift").values(), *slow.values())
    return float(np.sqrt(sum(v**2 for v in shares) / max(len(found.channels), 1)))


def _sample(found: Comparison) -> float:
    """Seconds of a sample; infinite where no horizon says."""
    each = (h.seconds / h.samples for h in found.unseen if h.samples and h.seconds)
    return next(each, np.inf)


def near_noise(found: Comparison, settings: Settings) -> bool:
    """Whether the noise explains all that a model leaves, on seen and unseen samples."""
    return not shortfalls(found, settings)


def predicts_nothing(found: Comparison, settings: Settings) -> bool:
    """Whether a free run on unseen data errs by all that moves there, more than noise explains.

    Noise that would be most of what a sensor shows explains nothing.
    """
    return not found.test_error < 1.0 and (drowned(found, settings) or errs(found, settings))


def drowned(found: Comparison, settings: Settings) -> bool:
    """Whether the noise of a sensor would be most of what it shows: such noise explains nothing."""
    return any(v > settings.noise_limit for v in coloured_noise(found).values())


def grown(before: Comparison, after: Comparison, settings: Settings) -> Change | None:
    """Where the error on unseen data grew from one model to another, if chance does not say why.

    Random forces move what runs freely, whatever the model: where they, and noise, make as much of
    it as is seen, and the model predicts better over shorter times, the free run is no witness.
    Forces above ``settings.random_limit`` are no explanation, of this neither.
    The other way round, what wanders at random follows readings more closely than what is constant
    does: where the free run is better and explained by noise, so is a next reading that is missed
    by no more than the sensors' noise.
    """
    judged = changes(before.unseen, after.unseen)
    told = not errs(after, settings)
    shorter = {c.judged for c in judged if c.samples is not None}
    free = {c.judged for c in judged if c.samples is None}
    forces = max(random_forces(after).values(), default=0.0)
    chance = told and forces <= settings.random_limit
    chance = chance and "better" in shorter and "worse" not in shorter
    noise = settings.chi2_limit * _floor(after, settings) ** 2 if told and "better" in free else 0.0
    for change in (c for c in judged if c.judged == "worse" and not _by_chance(c)):
        explained = chance if change.samples is None else change.after**2 <= noise
        if not explained:
            return change
    return None


def _by_chance(change: Change) -> bool:
    """Whether a finite error some time ahead grew by no more than it does by chance.

    A free run is excused by what noise and random forces make of it, and by nothing else.
    """
    grew = change.after - change.before
    ahead = change.samples is not None and bool(np.isfinite(grew))
    return ahead and grew <= _CHANCE * change.standard_error

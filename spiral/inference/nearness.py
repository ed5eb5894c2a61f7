"""How near a model comes to its noise, and whether one predicts better than another.

A model is *near its noise* where all of these hold:

    1 / L <= chi2 / dof <= L          on the samples that were fitted,
    p >= level or (Q - m) / N <= s^2  what is left is white, or its colour harmless,
    (test error)^2 <= L (floor)^2 + F d^2   on samples that no fit has seen,

with L = ``chi2_limit``, s = ``smallest``, p and Q of Ljung and Box over m lags, d what the fitted
random forces are expected to make of a free run (``engine.likelihood.free_spread``), F what their
mean square exceeds once in a hundred: chi2 / nu of as many independent values nu as they make of
the record, 6.6 where it is one stretch of what they move slowly, at least L.
No value may contradict the noise that makes up for the rest (``Comparison.contradictions``): a
damper of the given model that ended up feeding the machine, or most likely values more than three
standard errors from those whose free run is better on each other half of the record. Were the
forces beside the model random, both would come to the same values.

(Q - m) / N is about the share of what is left that its own past predicts: below s^2 it is smaller
than the smallest effect that counts. Colour is harmless, too, where up to a quarter of what is left
is told by its own past and less than s^2 by motion and inputs beside that
(``likelihood.independence``): it is the noise that is not quite as it was modelled. Both are shares
of the sensors' noise, of which misses beside noise that its past predicts are a small part. Where a
filter's likelihood is the evidence chi2 is that of the innovations; with ``strategy=innovation``
the test error is not asked: process noise moves what runs freely.
"""

from __future__ import annotations

import numpy as np
from scipy import special

from spiral.inference.disturbances import (
    coloured_noise,
    random_forces,
    what_acts,
)
from spiral.inference.problem import Settings
from spiral.types.formatting import number, percent
from spiral.types.horizon import Change, changes
from spiral.types.run import Comparison, StopReason

_EXCEEDED = 0.01  # how often random forces make more of a free run than is explained by them
_GONE = 0.5  # share of a squared error under which most of it is taken away
_HALF = 0.5  # of all motion: largest error one sample ahead where the free run is no witness
_AT_FLOOR = 1.2  # times the noise floor: within what is known of it
_GREW = 1.05  # times itself, from which the free run of fitted records is worse
_SMALL_PART = 0.25  # of the error that is left: a sixteenth of its square
_CHANCE = 2.0  # standard errors that an error ahead grows by chance once in forty
_COLOUR = 0.25  # share of what is left, half its deviation, up to which its own past may tell it


def has_little_colour(p: float, effect: float, settings: Settings) -> bool:
    """Whether a whiteness test finds none, or a colour that is smaller than any effect that counts.

    ``p`` is its p-value, ``effect`` its size, as in ``Whiteness``.
    """
    return p >= settings.whiteness_level or effect <= settings.smallest**2


def is_residual_white(comparison: Comparison, settings: Settings) -> bool:
    """Whether the residual is white, or its colour harmless.

    Colour is harmless where it is smaller than any effect, or predicted by its own past alone, not
    by motion or inputs; or where it belongs to a sensor whose noise is not white: no random force
    acts, and the free run is as near to the record as that noise lets it.
    """
    if has_little_colour(comparison.whiteness_p, comparison.whiteness_effect, settings):
        return True
    if has_own_colour(comparison, settings):
        return True
    at_floor = comparison.test_error <= _AT_FLOOR * comparison.noise_floor
    return bool(coloured_noise(comparison)) and at_floor and not random_forces(comparison)


def has_own_colour(comparison: Comparison, settings: Settings) -> bool:
    """Whether what is left has a colour that counts, and neither motion nor inputs explain it."""
    little = has_little_colour(comparison.whiteness_p, comparison.whiteness_effect, settings)
    alone = comparison.followed is not None and comparison.followed <= settings.smallest**2
    return not little and alone and comparison.whiteness_effect <= _COLOUR


def takes_little(before: float, after: float) -> bool:
    """Whether little of an error is taken away, beside what random forces make of it.

    That no effect takes away, and errors of several causes add up in squares.
    """
    return before**2 <= (1 + _SMALL_PART**2) * after**2


def takes_most(before: float, after: float) -> bool:
    """Whether more than half of a squared error is taken away."""
    return after**2 < _GONE * before**2


def evidence_chi2(comparison: Comparison) -> float:
    """Chi2 per degree of freedom of the strategy's residuals: of innovations, or on windows."""
    chi2 = comparison.innovation_chi2
    return comparison.chi2_per_dof if chi2 is None else chi2


def noise_factor(comparison: Comparison, settings: Settings) -> float:
    """Noise found over noise declared; 1 where the two do not contradict each other.

    What is left is white, and as large as the model-free estimate of the noise (or smaller than
    the noise is said to be): then it is the noise, and the statement is off.
    """
    chi2, limit = evidence_chi2(comparison), settings.chi2_limit
    if comparison.random is not None:  # the noise was fitted: its size against what is declared
        fitted = comparison.noise_ratio or 1.0
        return 1.0 if 1 / limit <= fitted**2 <= limit else fitted
    if (
        not is_residual_white(comparison, settings)
        or not np.isfinite(chi2)
        or 1 / limit <= chi2 <= limit
    ):
        return 1.0
    seen = comparison.noise_ratio
    agrees = seen is not None and 1 / limit <= chi2 / seen**2 <= limit
    return float(np.sqrt(chi2)) if chi2 < 1 / limit or agrees else 1.0


def shortfalls(comparison: Comparison, settings: Settings) -> tuple[str, ...]:
    """Why noise does not explain all that a model leaves: a phrase with its figure per reason."""
    limit = settings.chi2_limit
    factor = _scale_of_noise(comparison, settings)
    reasons = []
    if not comparison.converged:
        where = (
            "" if comparison.random is not None else f" on windows of {comparison.horizon} samples"
        )
        reasons.append(f"the fit did not converge{where}")
    if not evidence_chi2(comparison) <= limit * factor**2:
        reasons.append(
            f"chi2 per degree of freedom is {number(evidence_chi2(comparison))} (1 for noise alone)"
        )
    if not is_residual_white(comparison, settings):
        share = percent(min(comparison.whiteness_effect, 1.0))
        reasons.append(f"what is left is not white (its past predicts about {share} of it)")
    largest = max(random_forces(comparison).values(), default=0.0)
    alone = is_moved_unseen(comparison)
    if largest > settings.random_limit and not alone and not _moves_little(comparison, settings):
        share, acting = percent(largest), what_acts(comparison.model)
        reasons.append(
            f"a random {acting} of {share} of the machine's own {acting}s would have to act beside "
            "it"
        )
    reasons += comparison.contradictions
    if explains_nothing(comparison):
        reasons.append(
            f"its free run misses {percent(comparison.fit_error)} of the motion that it was fitted "
            "to: noise as large as that explains nothing"
        )
    for name, share in coloured_noise(comparison).items():
        if share > settings.noise_limit:
            where = name.partition(".")[2]
            reasons.append(f"the noise of sensor {where} would be {percent(share)} of its signal")
    if is_error_unexplained(comparison, settings):
        reasons.append(_unexplained_error_words(comparison, settings))
    return tuple(reasons)


def _unexplained_error_words(comparison: Comparison, settings: Settings) -> str:
    if is_free_run_carried_away(comparison):
        ahead = percent(next_sample_error(comparison) or 0.0)
        return f"one sample ahead the error on unseen data is {ahead}"
    made = float(np.hypot(_free_run_floor(comparison, settings), _random_spread(comparison)))
    error = percent(comparison.test_error)
    return f"the test error is {error} where noise explains {percent(made)}"


def _moves_little(comparison: Comparison, settings: Settings) -> bool:
    """Whether random forces move a free run by less than any effect that counts, and it errs so.

    Of a state that follows at once the rate is small, and what acts at random is much beside it: a
    radiator between the oil and the air. The motion tells how much it is.
    """
    moved = 0 < comparison.disturbed < settings.smallest
    return moved and comparison.test_error < settings.smallest


def _scale_of_noise(comparison: Comparison, settings: Settings) -> float:
    return 1.0 if comparison.random is not None else noise_factor(comparison, settings)


def _free_run_floor(comparison: Comparison, settings: Settings) -> float:
    """The error of a free run that noise of the sensors alone makes."""
    white = _scale_of_noise(comparison, settings) * comparison.noise_floor
    return float(np.hypot(white, comparison.drifting))


def _random_spread(comparison: Comparison) -> float:
    """Free-run error by random forces and by uncertain parameters and initial states."""
    return float(np.hypot(comparison.disturbed, comparison.uncertain))


def is_error_unexplained(comparison: Comparison, settings: Settings) -> bool:
    """Whether the error on unseen data exceeds what noise and random forces make of a free run.

    (test error)^2 > L (floor^2 - drift^2) + F (spread^2 + drift^2) as in the module's text. It is
    never so where random forces were not modelled: they move what runs freely. Where
    ``is_free_run_carried_away``, the error one sample ahead may not exceed half of all motion.
    """
    if comparison.innovation_chi2 is not None and comparison.random is None:
        return False
    floor, drifting = _free_run_floor(comparison, settings), comparison.drifting
    if is_free_run_carried_away(comparison):
        ahead = next_sample_error(comparison)
        return ahead is not None and not ahead <= max(_HALF, 2 * floor)
    allowed = settings.chi2_limit * (floor**2 - drifting**2) + _largest_spread(comparison, settings)
    return not comparison.test_error**2 <= allowed


def _largest_spread(comparison: Comparison, settings: Settings) -> float:
    """F (spread^2 + drift^2), which random forces, doubts and drifts exceed once in a hundred.

    F = chi2 / nu, nu = 2 m^2 / s^2 of their sum: the forces make ``disturbed_values`` of a record,
    a doubt or a drift one value each.
    """
    made = np.square([comparison.disturbed, comparison.uncertain, comparison.drifting])
    values = np.array([max(comparison.disturbed_values, 1.0), 1.0, 1.0])
    spread = float(np.sum(made**2 / values))
    nu = float(made.sum() ** 2 / spread) if 0 < spread < np.inf else 1.0
    return max(float(special.chdtri(nu, _EXCEEDED)) / nu, settings.chi2_limit) * float(made.sum())


def is_free_run_carried_away(comparison: Comparison) -> bool:
    """Whether random forces or uncertainty make the error of a free run as large as the motion.

    As of a machine that only its controller stabilises: a free run judges no model there.
    """
    return comparison.random is not None and (
        not _random_spread(comparison) < 1.0 or is_moved_unseen(comparison)
    )


def is_moved_unseen(comparison: Comparison) -> bool:
    """Whether a random force is what moves the machine: no input does, and it makes the motion.

    As of a bridge in the wind: how large such a force is speaks against no model.
    """
    return comparison.driven_unseen and comparison.disturbed > _HALF


def is_free_run_telling_little(comparison: Comparison, settings: Settings) -> bool:
    """Whether a free run misses more than half of all motion by what acts at random.

    That would hide whatever is as large. It is not so where the free run is carried away, nor where
    a sensor's noise makes the error.
    """
    misses_most = comparison.test_error > _HALF and not is_free_run_carried_away(comparison)
    return misses_most and is_moved_at_random(comparison, settings)


def is_undecided(comparison: Comparison, stopped: StopReason, settings: Settings) -> bool:
    """Whether what acts at random may hide what is missing, though noise and forces explain all.

    A free run tells little, or the search ended before all candidates were tried.
    """
    cut_short = stopped == "max_seconds" and is_moved_at_random(comparison, settings)
    return is_free_run_telling_little(comparison, settings) or cut_short


def is_moved_at_random(comparison: Comparison, settings: Settings) -> bool:
    """Whether a random force, and no noise of the sensors, makes most of a free run's error.

    What acts at random and what a parameter that varies would do look alike one sample ahead, and
    beside a force that lasts a missing effect makes little more likely.
    """
    noise = settings.chi2_limit * comparison.noise_floor**2
    return bool(random_forces(comparison)) and comparison.test_error**2 > noise


def may_noise_stand_in(comparison: Comparison, settings: Settings) -> bool:
    """Whether noise beside the model may do the work of what is missing.

    Noise of a sensor is mostly of another kind than white, as what rings or drifts is; or misses
    are white with a random force that carries the model's free run away from the record.
    """
    most = 0.5 * comparison.noise_floor**2
    coloured = any(share**2 > most for share in coloured_noise(comparison).values())
    white = comparison.whiteness_p >= settings.whiteness_level
    return coloured or (white and is_moved_at_random(comparison, settings))


def next_sample_error(comparison: Comparison) -> float | None:
    """The error on unseen data one sample ahead; nothing where there are none."""
    return next((h.error for h in comparison.unseen if h.samples == 1), None)


def is_near_noise(comparison: Comparison, settings: Settings) -> bool:
    """Whether the noise explains all that a model leaves, on seen and unseen samples."""
    return not shortfalls(comparison, settings)


def leaves_less_than_noise(error: float, last: Comparison, settings: Settings) -> bool:
    """Whether an error e of free runs has no more left to fall than the noise f of a later model.

    That is e^2 - f^2 <= (L - 1) f^2; never so where no free run tells.
    """
    limit = settings.chi2_limit * last.noise_floor**2
    return not is_free_run_carried_away(last) and error**2 <= limit


def predicts_nothing(comparison: Comparison, settings: Settings) -> bool:
    """Whether a free run on unseen data errs by all the motion, and noise does not explain it.

    Noise that would be most of what a sensor shows explains nothing, nor does any where a free run
    of the fitted record errs as much.
    """
    return not comparison.test_error < 1.0 and (
        is_drowned_in_noise(comparison, settings)
        or is_error_unexplained(comparison, settings)
        or explains_nothing(comparison)
    )


def explains_nothing(comparison: Comparison) -> bool:
    """Whether free runs err by all the motion, of the fitted record as well.

    The mean of a record does better; right or wrong, no model is told by noise so large.
    """
    away = is_free_run_carried_away(comparison)
    return not away and not min(comparison.fit_error, comparison.test_error) < 1.0


def is_drowned_in_noise(comparison: Comparison, settings: Settings) -> bool:
    """Whether the noise of a sensor would be most of what it shows: such noise explains nothing."""
    return any(v > settings.noise_limit for v in coloured_noise(comparison).values())


def unexplained_error_growth(
    before: Comparison, after: Comparison, settings: Settings
) -> Change | None:
    """The first horizon at which the error on unseen data grew and nothing random explains it.

    Growth of a free run is explained where noise and random forces up to ``settings.random_limit``
    make as much of its error, shorter horizons are better and none worse, and that of the fitted
    records did not grow as well: what acts at random is the same with either model, and other in
    other records. Growth at a shorter
    horizon is explained where the free run is better and explained by noise, and the error there
    is no more than the sensors' noise: a random walk in the former model follows readings more
    closely than the constant that took its place.
    """
    judged = changes(before.unseen, after.unseen)
    if is_moved_unseen(after):  # further ahead the force decides that is still to come
        judged = tuple(c for c in judged if c.samples == 1)
    told = not is_error_unexplained(after, settings)
    shorter = {c.judged for c in judged if c.samples is not None}
    free = {c.judged for c in judged if c.samples is None}
    forces = max(random_forces(after).values(), default=0.0)
    chance = told and forces <= settings.random_limit
    chance = chance and "better" in shorter and "worse" not in shorter
    chance = chance and not after.fit_error > _GREW * before.fit_error
    noise = (
        settings.chi2_limit * _free_run_floor(after, settings) ** 2
        if told and "better" in free
        else 0.0
    )
    for change in (c for c in judged if c.judged == "worse" and not _is_chance_growth(c)):
        explained = chance if change.samples is None else change.after**2 <= noise
        if not explained:
            return change
    return None


def _is_chance_growth(change: Change) -> bool:
    """Whether a finite error some time ahead grew by no more than it does by chance.

    A free run is excused by what noise and random forces make of it, and by nothing else.
    """
    grew = change.after - change.before
    ahead = change.samples is not None and bool(np.isfinite(grew))
    return ahead and grew <= _CHANCE * change.standard_error

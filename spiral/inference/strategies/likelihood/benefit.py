"""The test whether an effect is of use: it must improve predictions of unseen data, by enough."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spiral.inference.disturbances import random_forces, what_acts
from spiral.inference.nearness import (
    is_drowned_in_noise,
    is_free_run_carried_away,
    is_moved_unseen,
    is_residual_white,
    leaves_less_than_noise,
    takes_little,
    takes_most,
    unexplained_error_growth,
)
from spiral.inference.problem import Settings
from spiral.inference.strategy_options import LikelihoodOptions
from spiral.inference.verdict import MOST_AT_RANDOM, undetermined_effects
from spiral.types.effect import SensorEffect
from spiral.types.formatting import percent
from spiral.types.horizon import Change, changes
from spiral.types.run import Comparison

_ANSWER = (
    "without it white noise is left, and of free runs it takes little: as where a controller has "
    "answered to the noise of a reading in the same sample"
)
_HALF = 0.5  # of a squared error, which noise and chance make at least where they explain it
_BOUND = 0.99  # share of the largest random force from which one stands at its bound


@dataclass(frozen=True)
class Refusal:
    """Why a model with a candidate is refused.

    ``alone`` : it may be of use once what else is missing stands beside it. ``grows`` : errors on
    unseen data grow with it, which is of its values, not of the noise model beside them.
    """

    reason: str
    alone: bool = False
    grows: bool = False


def refuse_unhelpful(
    options: LikelihoodOptions, before: Comparison, after: Comparison, settings: Settings,
    freely: bool = False,
) -> Refusal | None:  # fmt: skip
    """Refuse an effect that does not improve predictions of unseen data; nothing where it does.

    The squared error that it takes away, over what is left, is a size in standard deviations of
    the noise; the largest over the horizons counts at which unseen data are predicted better, or
    the free run of the fitted records where there are no others. A free run that random forces move
    by more than noise does is no witness. Where the error has less than the noise left to fall, the
    effect must also change what is predicted of a reading by ``smallest_share`` of its motion:
    below that many effects do as well, and a name means little. What an unseen force moves errs by
    that force, whatever is missing: there likelihood alone tells. ``freely`` : free runs count,
    whatever random forces make of them.
    """
    if _is_force_at_bound(options, after):
        acting = what_acts(after.model)
        return Refusal(
            f"with it, too, a random {acting} as large as the machine's own would have to act: "
            "the fit has not found the right values, or the record is of another machine",
            alone=True,
        )
    if is_drowned_in_noise(after, settings) and not is_drowned_in_noise(before, settings):
        return Refusal("with it the noise of a sensor would be most of its signal", alone=True)
    if _is_answer_to_noise(before, after, settings):
        return Refusal(_ANSWER)
    judged_ = changes(before.unseen, after.unseen)
    if (grows := refuse_growing_error(before, after, settings)) is not None:
        return grows
    if is_moved_unseen(after):
        return None
    freely |= after.disturbed <= after.noise_floor
    told = [c for c in judged_ if c.samples is not None or freely]
    seen = [] if judged_ else [(before.fit_error, after.fit_error)]
    pairs = [*seen, *((c.before, c.after) for c in told if c.judged == "better")]
    size = max((_reduction_size(b, a) for b, a in pairs), default=0.0)
    if max(size, _force_replacement_share(before, after)) >= settings.smallest:
        if judged_ and _leaves_free_run(before, after, settings):
            return Refusal(
                f"it leaves the free run on unseen data as it was ({percent(after.test_error)}), "
                f"and neither noise nor random {what_acts(after.model)}s make most of that error",
                alone=True,
            )
        return _refuse_below_noise(before, after, told, settings)
    removed = f"no more than {percent(size)}" if size > 0 else "nothing"
    return Refusal(
        f"significant, but too small to matter: over every horizon it removes {removed} of the "
        f"error that is left (least {percent(settings.smallest)})"
    )


def _is_force_at_bound(options: LikelihoodOptions, after: Comparison) -> bool:
    """Whether the largest random force that a fit has acts, and moves most of a free run."""
    forces = max(random_forces(after).values(), default=0.0)
    largest = forces >= _BOUND * options.random_limit and not after.disturbed < MOST_AT_RANDOM
    return largest and not is_moved_unseen(after)


def _leaves_free_run(before: Comparison, after: Comparison, settings: Settings) -> bool:
    """Whether a free run errs as before, and more than half of its squared error is unexplained."""
    if is_free_run_carried_away(after):
        return False
    if _reduction_size(before.test_error, after.test_error) >= settings.smallest:
        return False
    parts = (after.noise_floor, after.disturbed, after.uncertain, after.drifting)
    return _HALF * after.test_error**2 > sum(p**2 for p in parts)


def refuse_growing_error(
    before: Comparison, after: Comparison, settings: Settings
) -> Refusal | None:
    """Refuse a model whose error on unseen data grows by more than chance and noise excuse.

    That it ``grows`` by its values is not said where more than half of the squared error of free
    runs of the fitted records is gone: then the noise model beside them may be what is wrong.
    """
    worse = unexplained_error_growth(before, after, settings)
    if worse is None:
        return None
    said = f"{worse.horizon}: {100 * worse.before:.3g} -> {100 * worse.after:.3g} %"
    grows = not takes_most(before.fit_error, after.fit_error)
    return Refusal(f"the error on unseen data grows ({said})", alone=True, grows=grows)


def _is_answer_to_noise(before: Comparison, after: Comparison, settings: Settings) -> bool:
    """Whether a sensor follows an input of the same sample beside what was white noise before.

    A controller that has seen a reading answers to its noise in the same sample, so that its input
    tells of that noise. Such an input takes nothing of a free run's error but noise.
    """
    known, system = before.model.labels, after.model.system
    given = {i.name for i in system.inputs}
    new = (e for e in after.model.effects if e.label not in known and isinstance(e, SensorEffect))
    if not any(e.driver and system.place(e).against in given for e in new):
        return False
    errors = ((before.fit_error, after.fit_error), (before.test_error, after.test_error))
    vain = is_free_run_carried_away(before) or all(takes_little(b, a) for b, a in errors)
    return vain and is_residual_white(before, settings)


def _refuse_below_noise(
    before: Comparison, after: Comparison, told: list[Change], settings: Settings
) -> Refusal | None:
    """Refuse an effect beneath the noise that changes predictions by too small a share of motion.

    The share is sqrt(before^2 - after^2) of errors over a reading's deviation, the largest over
    the horizons that are ``told`` and the readings. Beside an effect of whose values the record
    tells none nothing is refused so: that may only stand in for what is missing.
    """
    model = before.model
    added = [e.label for e in model.effects if e not in model.system.seed]
    if undetermined_effects(model, added, settings):
        return None
    if not leaves_less_than_noise(before.test_error, after, settings):
        return None
    old, new = ({h.name: h.channels for h in c.unseen} for c in (before, after))
    pairs = [(old[c.horizon][j], e) for c in told for j, e in new[c.horizon].items()]
    pairs = pairs or [(before.fit_error, after.fit_error)]
    share = max(np.sqrt(max(b**2 - a**2, 0.0)) for b, a in pairs)
    if share >= settings.smallest_share:
        return None
    return Refusal(
        f"significant, but smaller than the noise and too small to matter: it changes what is "
        f"predicted by {percent(share)} of the motion (least {percent(settings.smallest_share)})"
    )


def _reduction_size(before: float, after: float) -> float:
    """Size of the error removed, sqrt(before^2 / after^2 - 1), over the error that is left."""
    size = np.sqrt(max((before / after) ** 2 - 1, 0.0)) if after > 0 else np.inf
    return float(size) if np.isfinite(size) else np.inf


def _force_replacement_share(before: Comparison, after: Comparison) -> float:
    """How far an effect replaces random forces that moved the free runs: the share that is gone.

    Free runs of fitted and test records must improve with it, by more than little. An effect with
    states of its own is a force with a memory itself: none.
    """
    forces = [max(random_forces(c).values(), default=0.0) for c in (before, after)]
    new = [e for e in after.model.effects if e.label not in before.model.labels]
    if not forces[0] > 0 or any(e.states for e in new):
        return 0.0
    pairs = [(before.fit_error, after.fit_error)]
    pairs += [(before.test_error, after.test_error)] if after.unseen else []
    if any(takes_little(*pair) for pair in pairs):
        return 0.0
    return 1.0 - forces[1] / forces[0]

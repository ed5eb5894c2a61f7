"""The corner of a stop, a gap or a rim is rounded over a part of the motion, or it is none.

Of (x - g)_+ with its corner rounded over +-w a motion within the rounding shows (x - g + w)^2/(4 w)
alone: a square, of which stiffness, gap and width are known in combination only. Such a stop stood
in for the quadratic stiffness of a measured circuit, and left more than noise.
"""

import numpy as np
import pytest
from spiral_plugins.effects.restoring import Stop
from spiral_plugins.systems.oscillator import Oscillator

import spiral
from spiral.inference.evidence.assembly import Variant, build_variants
from spiral.inference.problem import Problem
from spiral.inference.simulate import simulate
from spiral.inference.strategies.likelihood.meaning import refuse_shapes
from spiral.types.model import seed_model
from tests.swept_oscillator import RATE, TRUTH, record_of

LIMITS = {"stop.width": 0.05}


def test_a_corner_is_one_up_to_a_width_of_a_quarter_of_the_largest_motion():
    record = record_of(0, noise=0.0)
    problem = Problem(seed_model(Oscillator(), values=TRUTH), (record,), (), candidates=(Stop(),))
    variants, _, _ = build_variants(problem, ())
    most = 0.25 * np.abs(record.channels["x"]).max()
    for one in variants:
        assert one.limits == {f"{one.label}.width": pytest.approx(most, rel=1e-2)}


def test_beyond_that_a_stop_is_told_only_where_it_leaves_nothing():
    """Within a rounded corner (x + w)^2/(4 w) a smooth spring and a stop are one."""
    variant = Variant(Stop(), Stop(), {"stop.gap": 0.1, "stop.width": 0.004}, limits=LIMITS)
    for width, refused in ((0.04, False), (0.06, True)):
        model = seed_model(Oscillator(), (Stop(),), values={"stop.gap": 0.1, "stop.width": width})
        refusal = refuse_shapes(model, variant, near=False)
        assert (refusal is not None) == refused
        assert refuse_shapes(model, variant, near=True) is None
    assert refusal is not None
    assert "over too much of the motion" in refusal.reason


def test_a_stop_with_a_corner_is_told():
    values = {**TRUTH, "stop.stiffness": 300.0, "stop.gap": 0.05}
    result = spiral.discover(
        record=shaken((Stop(),), values, 1), test=shaken((Stop(),), values, 2),
        system="oscillator", values={k: 1.1 * v for k, v in TRUTH.items()},
        candidates=["stop", "quadratic_stiffness", "clearance"],
    )  # fmt: skip
    assert result.missing == ("stop",)
    assert result.model.values["stop.gap"] == pytest.approx(0.05, abs=0.01)


def shaken(effects, values, seed):
    """15 s of an oscillator with these effects, shaken at random, read with 1 % of noise."""
    rng = np.random.default_rng(seed)
    time = np.arange(3000) / RATE
    force = np.convolve(rng.normal(size=len(time)), np.hanning(15), mode="same")
    model = seed_model(Oscillator(), effects, values=values)
    return simulate(model, time, {"force": 8.0 * force / force.std()}, 0.01, rng)

"""Evidence from a filter's innovations: exact slopes, the level of its tests, its estimates."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from spiral_plugins.effects.dissipative import QuadraticDamping
from spiral_plugins.effects.restoring import ConstantLoad, CubicStiffness
from spiral_plugins.gates.innovation import Innovation
from spiral_plugins.gates.joint import ValidationRollback
from spiral_plugins.strategies.innovation import Innovation as ByInnovations
from spiral_plugins.systems.oscillator import Oscillator

from spiral.engine.filter.innovation_fit import climb_likelihood
from spiral.engine.filter.setup import prepare_filter, with_level
from spiral.engine.filter.stochastic import simulate_disturbed
from spiral.engine.filter.task import prepare_task, with_record
from spiral.engine.filter.whitened import whiten_innovations
from spiral.engine.gate import Trial
from spiral.inference.discover import discover
from spiral.inference.problem import Problem
from spiral.inference.simulate import simulate
from spiral.io.conformance.regression import trial
from spiral.types.errors import ConfigError
from spiral.types.model import seed_model

CUBIC, LOAD = "cubic_stiffness.stiffness", "constant_load.force"
KNOWN = {"system.mass": 1.0, "linear_stiffness.stiffness": 400.0,
         "linear_damping.damping": 1.2, CUBIC: 0.0, LOAD: 0.0}  # fmt: skip
LEVELS = {"observed": 0.2}  # process noise, truly there and told to the filter


@pytest.fixture(scope="module")
def base():
    """A driven oscillator of 3.2 Hz, 4 s at 200 Hz, with a cubic spring and a load of zero."""
    model = seed_model(Oscillator(), (CubicStiffness(), ConstantLoad()), values=KNOWN)
    time = 0.005 * np.arange(800)
    force = 10.0 * np.random.default_rng(0).normal(size=800)
    record = simulate(model, time, {"force": force}, 0.05, np.random.default_rng(1))
    return prepare_task(model, record, every=True)


def drawn(base, seed, **values):
    """A new draw of process and measurement noise, and the model told that nothing is missing."""
    truth = base.with_values({CUBIC: values.get("cubic", 0.0)})
    record = simulate_disturbed(truth, LEVELS, 0.05, np.random.default_rng(seed))
    return prepare_filter(with_record(base, record), ())


def test_slopes_are_those_of_the_innovations_where_the_gain_does_not_depend_on_them(base):
    """A constant load shifts the mean of a linear filter and nothing else."""
    task, settings = drawn(base, 1)
    settings = with_level(task, settings, LEVELS)
    found = whiten_innovations(task, settings, (LOAD, CUBIC))
    size = 3.0
    above, below = (
        whiten_innovations(task.with_values({LOAD: s}), settings, ()).innovations
        for s in (size, -size)
    )
    slope = -(above - below) / (2 * size)
    np.testing.assert_allclose(found.columns[..., 0], slope, atol=1e-9 * np.abs(slope).max())


def test_a_sample_that_is_missing_says_nothing(base):
    task, settings = drawn(base, 1)
    y = task.series.y.copy()
    y[100:140] = np.nan
    gap = replace(task, series=replace(task.series, y=y))
    found = whiten_innovations(gap, with_level(gap, settings, LEVELS), (LOAD,))
    assert not found.innovations[100:140].any()
    assert not found.columns[100:140].any()
    assert np.isfinite(found.innovations).all()


def test_the_score_test_has_its_level(base):
    """Under the null the fall of |e|^2 for one step in two parameters is chi^2 of two."""
    falls = []
    for seed in range(200):
        task, settings = drawn(base, 100 + seed)
        found = whiten_innovations(task, with_level(task, settings, LEVELS), (CUBIC, LOAD))
        falls.append(regression(found).falls([(0, 1)])[(0, 1)])
    assert stats.kstest(falls, stats.chi2(2).cdf).pvalue > 1e-3
    low, high = stats.binom.ppf([5e-4, 1 - 5e-4], 200, 0.05) / 200
    assert low <= np.mean(np.array(falls) > stats.chi2.ppf(0.95, 2)) <= high


def regression(found):
    e, columns = found.innovations, found.columns
    n, count = len(e), columns.shape[2]
    return Trial(
        tuple(map(str, range(count))), tuple(range(count)), e, columns[..., :0], columns, e,
        np.ones(n, dtype=bool), np.ones(n), np.zeros(n, dtype=int),
    )  # fmt: skip


def test_the_likelihood_finds_a_hidden_spring_within_its_standard_errors(base):
    """Real process noise, known to the filter; the errors of 30 draws are standard normal."""
    errors, spreads = [], []
    for seed in range(30):
        task, settings = drawn(base, 300 + seed, cubic=1e5)
        found = climb_likelihood(((task, settings),), (CUBIC,), LEVELS)
        errors.append((found.values[task.keys.index(CUBIC)] - 1e5) / found.errors[CUBIC])
        spreads.append(found.errors[CUBIC])
    assert np.median(spreads) < 0.5 * 1e5
    low, high = np.sqrt(stats.chi2.ppf([5e-4, 1 - 5e-4], 30) / 30)
    assert low <= np.sqrt(np.mean(np.square(errors))) <= high


@pytest.mark.parametrize("cubic", [0.0, 6e5])
def test_the_loop_finds_a_spring_by_innovations_where_process_noise_is_real(base, cubic):
    """A free run fails here whatever the model: process noise moves the oscillator."""
    task, _ = drawn(base, 500, cubic=cubic)
    known = {k: v for k, v in KNOWN.items() if k not in (CUBIC, LOAD)}
    model = seed_model(Oscillator(), values=known, fixed=tuple(known))
    candidates = (CubicStiffness(), ConstantLoad(), QuadraticDamping())
    record = (task.series.record,)
    strategy = ByInnovations(gate=(Innovation(), ValidationRollback()))
    found = discover(Problem(model, record, record, 0.1, candidates, strategy=strategy))
    admitted = [r.admitted for r in found.rounds[1:]]
    assert admitted == ([("cubic_stiffness",)] if cubic else [])
    assert found.verdict == ("effect_missing" if cubic else "nothing_missing")
    assert found.final.chi2_per_dof > 2  # of the free run
    if cubic:
        error = found.model.values[CUBIC] - cubic
        assert abs(error) < 4 * found.model.errors[CUBIC]


def test_the_gate_lets_the_most_likely_candidate_through_alone():
    asked = trial()
    found = Innovation().judge(asked)
    assert found.kept == (0,)
    every = np.ones(len(asked.target), dtype=bool)
    nested, whole = asked.fitted((), every).rss, asked.fitted((0,), every).rss
    assert found.log["score"]["a"] == pytest.approx(nested - whole)
    assert found.log["gain"] == {"a": pytest.approx((nested - whole) / 0.1**2)}


def test_the_gate_names_candidates_that_the_likelihood_cannot_tell_apart():
    gains = {(0,): 500.0, (1,): 497.0, (2,): 80.0}
    asked = replace(trial(), gain=lambda group: gains[group])
    strong = asked.candidates[..., :1] + 0.01 * asked.candidates
    found = Innovation().judge(replace(asked, candidates=strong))
    assert (found.kept, found.log["alike"]) == ((0,), ["b"])
    assert set(found.refused) == {"b", "c"}


def test_the_gate_needs_a_likelihood():
    with pytest.raises(ConfigError, match="strategy=innovation"):
        Innovation().judge(replace(trial(), gain=None))

"""Gates on exact cases: error rates, robust errors, clusters, folds, roll-back."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from spiral_plugins.gates.joint import KfoldMajority, PartialF, ValidationRollback
from spiral_plugins.gates.robust import BlockBootstrapT, HacT
from spiral_plugins.gates.screening import BonferroniT, Contribution, CorrelationCluster
from spiral_plugins.gates.whiteness import LjungBox

from spiral.engine.gate import Surface, Trial
from spiral.engine.leastsquares import least_squares
from spiral.inference.paper.robust import bootstrap_errors, hac_errors

CANDIDATES = 5


def coloured(rng, n, channels, memory):
    from scipy.signal import lfilter

    noise = rng.normal(size=(n + 500, channels))
    return lfilter([np.sqrt(1 - memory**2)], [1, -memory], noise, axis=0)[500:]


def trial(seed, n=400, truth=(0.0,) * CANDIDATES, memory=0.0, slow=0.0, noise=1.0):
    """Two equations, two active columns, and candidates that are themselves coloured."""
    rng = np.random.default_rng(seed)
    active = rng.normal(size=(n, 2, 2))
    columns = np.stack([coloured(rng, n, 2, slow) for _ in truth], axis=2)
    target = active @ np.array([1.0, -2.0]) + columns @ np.array(truth)
    target = target + noise * coloured(rng, n, 2, memory)
    train = (np.arange(n) // 50) % 10 < 7
    bare = Trial(
        tuple(f"c{i}" for i in range(len(truth))), tuple(range(len(truth))), target, active,
        columns, target, train, np.abs(columns[:, 0, 0]), np.zeros(n, dtype=int), None, seed,
    )  # fmt: skip
    return replace(bare, residual=target - active @ bare.before.b)


def rate(judge, count=200, **options):
    return np.mean([judge(trial(seed, **options)) for seed in range(count)])


def within(observed, expected, count):
    """Inside the 99.9 % band of a binomial share."""
    low, high = stats.binom.ppf([5e-4, 1 - 5e-4], count, expected) / count
    return low <= observed <= high


def test_gate_1_holds_its_family_wise_rate_without_a_surface():
    found = rate(lambda t: bool(BonferroniT(alpha=0.05).judge(t).kept), 200)
    assert found <= stats.binom.ppf(0.9995, 200, 0.05) / 200


def test_partial_f_has_its_level_and_power():
    assert within(rate(lambda t: bool(PartialF().judge(t).kept), 200), 0.05, 200)
    strong = trial(1, truth=(0.5, 0, 0, 0, 0))
    judged = PartialF().judge(strong)
    assert judged.kept == strong.kept
    nested = least_squares(*strong.rows((), strong.train))
    whole = least_squares(*strong.rows(strong.kept, strong.train))
    f = ((nested.rss - whole.rss) / 5) / (whole.rss / (whole.rows - 7))
    assert judged.log["statistic"] == pytest.approx(f)


def test_gate_1_on_a_surface_passes_more_with_more_points():
    """Design, fact 12: a surface has no noise, so t grows as the square root of the points."""
    rng = np.random.default_rng(0)
    passed = []
    for points in (1000, 100_000):
        x = rng.normal(size=(points, CANDIDATES))
        y = np.tanh(x[:, 0]) + 0.02 * x[:, 1] * x[:, 2] + 0.01 * np.sin(x).sum(axis=1)
        surface = Surface(least_squares(x, y), points, 0.0)
        passed.append(len(BonferroniT().judge(replace(trial(0), surface=surface)).kept))
    assert passed[0] < passed[1] == CANDIDATES


def test_hac_is_that_of_statsmodels_for_one_equation():
    import statsmodels.api as sm

    one = trial(3, memory=0.8, slow=0.8)
    one = replace(
        one, target=one.target[:, :1], active=one.active[:, :1], candidates=one.candidates[:, :1],
        residual=one.residual[:, :1],
    )  # fmt: skip
    fit = one.fitted(one.kept)
    x, y = one.rows(one.kept, one.train)
    theirs = sm.OLS(y, x).fit(cov_type="HAC", cov_kwds={"maxlags": 7, "use_correction": True})
    assert hac_errors(one, one.kept, fit, 7) == pytest.approx(theirs.bse, rel=1e-9)


@pytest.mark.parametrize(("memory", "slow"), [(0.0, 0.0), (0.95, 0.95)])
def test_plain_errors_are_right_for_white_noise_and_too_small_for_coloured(memory, slow):
    """Against the scatter of the estimates over seeds (design, fact 11)."""
    scatter, plain, robust, drawn = [], [], [], []
    for seed in range(60):
        t = trial(seed, n=3000, memory=memory, slow=slow)
        fit = t.fitted(t.kept)
        scatter.append(fit.b[2:])
        plain.append(fit.se[2:])
        robust.append(hac_errors(t, t.kept, fit, 60)[2:])
        drawn.append(bootstrap_errors(t, t.kept, fit, 200, 200)[2:])
    true = np.sqrt(np.mean(np.square(scatter)))
    plain, robust, drawn = (np.mean(e) for e in (plain, robust, drawn))
    if memory == 0:
        assert plain == pytest.approx(true, rel=0.15)
    else:
        assert plain < 0.4 * true
    assert robust == pytest.approx(true, rel=0.3)
    assert drawn == pytest.approx(true, rel=0.3)


def test_robust_gates_refuse_what_plain_ones_admit():
    """Slow noise on slow regressors: F admits batches that mean nothing, robust t seldom does."""
    options = {"n": 3000, "memory": 0.95, "slow": 0.95}
    admitted = rate(lambda t: bool(PartialF().judge(t).kept), 40, **options)
    assert admitted > 0.9
    for gate in (HacT(lags=60), BlockBootstrapT(block=200, draws=200)):
        assert rate(lambda t, g=gate: bool(g.judge(t).kept), 40, **options) < 0.35
        assert gate.judge(trial(0, n=3000, truth=(1.0, 0, 0, 0, 0), **{
            k: v for k, v in options.items() if k != "n"})).kept[:1] == (0,)  # fmt: skip


def test_the_guard_stops_at_white_and_not_at_coloured_residuals():
    white = rate(
        lambda t: LjungBox().judge(replace(t, residual=t.target * 0 + _white(t))).log["white"]
    )
    assert within(white, 0.95**2, 200)  # both equations must be white
    assert not LjungBox().judge(trial(0, memory=0.3, truth=(0.0,))).log["white"]
    judged = LjungBox().judge(replace(trial(0), residual=_white(trial(1))))
    if judged.log["white"]:
        assert judged.reason == "white"


def _white(t):
    return np.random.default_rng(t.seed + 10_000).normal(size=t.residual.shape)


def test_of_a_cluster_the_strongest_is_carried():
    t = trial(0, truth=(0.0, 1.0, 0.0, 0.0, 0.0))
    columns = t.candidates.copy()
    columns[..., 0] = columns[..., 1] + 0.3 * columns[..., 0]  # rho 0.96
    judged = CorrelationCluster().judge(replace(t, candidates=columns))
    assert judged.kept == (1, 2, 3, 4)
    assert judged.log["clusters"] == [{"carried": "c1", "members": ["c0", "c1"]}]
    assert "one cluster with c1" in judged.refused["c0"]


def test_a_negligible_contribution_is_refused_whatever_its_unit():
    t = trial(0, n=20_000, truth=(1.0, 0.01, 0.0, 0.0, 0.0), noise=0.1)
    columns = t.candidates * np.array([1.0, 1e-9, 1.0, 1e6, 1.0])
    for candidates in (t.candidates, columns):
        judged = Contribution(share=0.05).judge(replace(t, candidates=candidates))
        assert judged.kept == (0,)


def test_folds_need_a_majority():
    t = trial(0, n=4000, truth=(0.3, 0.0, 0.0, 0.0, 0.0))
    judged = KfoldMajority().judge(t)
    assert judged.kept == (0,)
    assert judged.log["votes"]["c0"] == 7
    assert judged.log["needed"] == 4
    null = rate(lambda t: len(KfoldMajority().judge(t).kept) / CANDIDATES, 25, n=2000)
    assert null < 0.1


def test_folds_see_every_amplitude():
    t = trial(0, n=8000, slow=0.99)
    fold = KfoldMajority()._deal_folds(t)
    amplitude = t.amplitude[t.train]
    means = [np.mean(amplitude[fold == f] ** 2) for f in range(7)]
    assert np.std(means) < 0.2 * np.mean(means)


def test_what_predicts_worse_is_rolled_back():
    t = trial(0, truth=(0.4, 0.0, 0.0, 0.0, 0.0))
    assert ValidationRollback().judge(t).kept == t.kept
    shifted = t.target.copy()
    shifted[~t.train] -= 2 * 0.4 * t.candidates[~t.train, :, 0]  # the other sign where it validates
    judged = ValidationRollback().judge(replace(t, target=shifted))
    assert judged.kept == ()
    assert judged.reason == "rolled_back"
    assert judged.log["rolled_back"]

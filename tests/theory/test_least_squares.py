"""Least squares by scaled QR, and its diagnostics, against exact cases and statsmodels."""

import numpy as np
import pytest
from scipy import linalg

from spiral.engine.leastsquares import (
    adjusted_r2,
    least_squares,
    leverages,
    partial_f,
    press,
    solve_triangle,
    triangle,
    variance_inflation,
)


def problem(seed=0, n=200, k=4):
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(n, k)) * 10.0 ** np.array([0, -8, 6, 3])[:k]
    b = rng.normal(size=k) / 10.0 ** np.array([0, -8, 6, 3])[:k]
    return x, x @ b + rng.normal(size=n), b


def test_columns_of_any_size_keep_their_coefficients():
    """Design, fact 10: raw columns of 1e-14 against 1 lose the small one in a pseudo-inverse."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(500, 2)) * [1.0, 1e-14]
    b = np.array([1.0, 2e14])
    fit = least_squares(x, x @ b)
    assert fit.b == pytest.approx(b, rel=1e-9)
    assert fit.kept.all()


def test_the_figures_are_those_of_statsmodels():
    import statsmodels.api as sm

    x, y, _ = problem()
    scale = np.linalg.norm(x, axis=0)
    theirs = sm.OLS(y, x / scale).fit()
    fit = least_squares(x, y)
    assert fit.b * scale == pytest.approx(theirs.params)
    assert fit.t == pytest.approx(theirs.tvalues)
    assert fit.rss == pytest.approx(theirs.ssr)
    influence = theirs.get_influence()
    assert leverages(x, fit) == pytest.approx(influence.hat_matrix_diag)
    assert press(x, y, fit) == pytest.approx(np.sum(influence.resid_press**2))
    before = least_squares(x[:, :2], y)
    f, p = partial_f(before, fit)
    nested = theirs.compare_f_test(sm.OLS(y, x[:, :2]).fit())
    assert (f, p) == pytest.approx(nested[:2])


def test_press_is_leaving_one_out():
    x, y, _ = problem(n=12)
    errors = []
    for i in range(len(y)):
        left = np.arange(len(y)) != i
        errors.append(y[i] - x[i] @ least_squares(x[left], y[left]).b)
    assert press(x, y, least_squares(x, y)) == pytest.approx(np.sum(np.square(errors)))


def test_streamed_blocks_give_the_whole():
    x, y, _ = problem()
    rows = np.column_stack([x, y])
    upper, count = triangle(np.array_split(rows, 7))
    fit, whole = solve_triangle(upper, count), least_squares(x, y)
    assert fit.b == pytest.approx(whole.b)
    assert fit.se == pytest.approx(whole.se)
    part = solve_triangle(upper, count, (0, 2))
    assert part.b == pytest.approx(least_squares(x[:, [0, 2]], y).b)


def test_a_column_that_others_make_up_is_dropped_and_named():
    x, y, _ = problem()
    doubled = np.column_stack([x, 3 * x[:, 0] - 1e-3 * x[:, 2]])
    fit = least_squares(doubled, y)
    assert fit.kept.tolist() == [True] * 4 + [False]
    assert fit.b[-1] == 0
    assert np.isinf(fit.se[-1])
    assert fit.t[-1] == 0
    assert fit.rss == pytest.approx(least_squares(x, y).rss)
    assert np.isinf(variance_inflation(doubled)[[0, 2, 4]]).all()


def test_inflation_needs_centred_columns_of_unit_size():
    """Design, fact 15: the paper's formula as printed depends on the columns' units."""
    rng = np.random.default_rng(0)
    z = rng.normal(size=(4000, 2))
    x = np.column_stack([z[:, 0], 0.8 * z[:, 0] + 0.6 * z[:, 1]])

    def printed(x):
        r = linalg.qr(x, mode="economic")[1]
        return np.linalg.norm(np.linalg.inv(r), axis=1) ** 2 * (len(x) - 1)

    exact = 1 / (1 - 0.64)
    assert variance_inflation(1e-6 * x + 1e-4) == pytest.approx(exact, rel=0.1)
    assert printed(x - x.mean(axis=0)) == pytest.approx(exact, rel=0.1)
    assert np.all(printed(1e-6 * x) > 1e11)


def test_adjusted_r2_falls_with_a_column_that_tells_nothing():
    rng = np.random.default_rng(3)
    x = rng.normal(size=(200, 1))
    y = x[:, 0] + rng.normal(size=200)
    noise = rng.normal(size=(200, 1))
    noise -= x * (x[:, 0] @ noise[:, 0]) / (x[:, 0] @ x[:, 0])
    noise -= np.outer(y, y @ noise) / (y @ y)  # exactly useless
    wide = np.column_stack([x, noise])
    assert adjusted_r2(y, least_squares(wide, y)) < adjusted_r2(y, least_squares(x, y))

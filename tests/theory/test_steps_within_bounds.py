"""Steps of a regression whose values may not leave their bounds."""

import numpy as np
from scipy.optimize import lsq_linear

from spiral.engine.leastsquares import solve_triangle, triangle
from spiral.engine.likelihood.steps import damped_solution, drop_bounded_columns


def _problem(seed):
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(40, 4)), rng.normal(size=40)
    x[:, 3] += 0.9 * x[:, 0]  # columns that share something
    return x, y, *triangle([np.column_stack([x, y])])


def test_a_value_that_presses_on_its_bound_stays_and_the_others_step_as_if_it_were_held():
    """Values at their lower bound with a step outward: the least squares of the others alone."""
    for seed in range(20):
        x, y, upper, rows = _problem(seed)
        limits = np.array([[0.0, np.inf], [-np.inf, np.inf], [0.0, np.inf]])
        inner, gain = drop_bounded_columns(upper, solve_triangle(upper, rows), np.zeros(3), limits)
        step = damped_solution(inner, np.linalg.norm(inner[:, :-1], axis=0), 0.0)
        held = np.flatnonzero(~inner[:, :-1].any(axis=0))
        free = [j for j in range(4) if j not in held]
        wanted = np.linalg.lstsq(x[:, free], y, rcond=None)[0]
        np.testing.assert_allclose(step[free], wanted, rtol=1e-9)
        damped = damped_solution(inner, np.linalg.norm(inner[:, :-1], axis=0), 0.03)
        assert np.all(step[held] == 0.0)
        assert np.all(damped[held] == 0.0)
        assert min(step[0], step[2]) >= 0
        rss = np.sum((y - x[:, free] @ wanted) ** 2)
        np.testing.assert_allclose(gain, 0.5 * (np.sum(y**2) - rss), rtol=1e-9)


def test_the_step_is_that_of_bounded_least_squares_with_one_bound():
    """One bound has one active set: SciPy's bounded solution."""
    for seed in range(20):
        x, y, upper, rows = _problem(seed)
        inner, _ = drop_bounded_columns(
            upper, solve_triangle(upper, rows), np.zeros(1), np.array([[0, np.inf]])
        )
        step = damped_solution(inner, np.linalg.norm(inner[:, :-1], axis=0), 0.0)
        wanted = lsq_linear(x, y, ([0, -np.inf, -np.inf, -np.inf], np.inf), tol=1e-14).x
        np.testing.assert_allclose(step, wanted, atol=1e-7)

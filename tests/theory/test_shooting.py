"""The engine against dense linear algebra, differences, and the order of its integrator."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from spiral_plugins.systems.oscillator import Oscillator
from spiral_plugins.systems.planar_rotor import PlanarRotor

import spiral.engine.sensitivities as sensitivities
from spiral.engine.elimination import eliminate_initial_states
from spiral.engine.fit import covariance, fit
from spiral.engine.growth import first_starts, layouts_for
from spiral.engine.score import build_score_table, score
from spiral.engine.sensitivities import reduce_windows, residuals, run_windows
from spiral.engine.series import prepare_series
from spiral.engine.study import CompiledStudy, ParameterColumns, Point
from spiral.engine.windows import block_length, cut_windows, halves, stage_lengths
from spiral.inference.simulate import integrate
from spiral.physics.compile import compile_model
from spiral.physics.trace import trace
from spiral.types.model import Model, seed_model
from tests.scenes import SEED_TRUTH, effect, planar_record


def _study(duration=1.2, effects=("gyroscopic", "cubic_stiffness"), seed=3):
    base = seed_model(PlanarRotor())
    more = tuple(effect(e) for e in effects)
    record = planar_record(seed, duration=duration)
    compiled = compile_model(trace(base.system, (*base.effects, *more)))
    study = CompiledStudy(compiled, (prepare_series(base.system, record, 1),))
    values = np.zeros((1, len(study.keys)))
    for key, value in {**SEED_TRUTH, "system.phase_origin": 0.4}.items():
        values[0, study.index(key)] = value
    moving = np.arange(len(study.keys))
    return study, values, ParameterColumns(moving, np.full(len(moving), -1))


def _point(study, values, layouts):
    return Point(values, first_starts(study, layouts, values))


def test_the_integrator_has_order_four():
    model = Model(
        Oscillator(),
        (*seed_model(Oscillator()).effects, effect("cubic_stiffness")),
        {
            "system.mass": 1.0,
            "linear_stiffness.stiffness": 40.0,
            "linear_damping.damping": 0.3,
            "cubic_stiffness.stiffness": 25.0,
        },
    )

    def exact():
        def rate(t, x):
            return [x[1], -40 * x[0] - 0.3 * x[1] - 25 * x[0] ** 3]

        return solve_ivp(rate, (0, 3.2), [1.0, 0.0], rtol=1e-13, atol=1e-14).y[:, -1]

    errors, steps = [], []
    truth = exact()
    for count in (160, 320, 640, 1280):
        time = 3.2 / count * np.arange(count + 1)
        states, _ = integrate(model, time, {"force": np.zeros(count + 1)}, {"x": 1.0}, substeps=1)
        errors.append(np.linalg.norm(states[-1] - truth))
        steps.append(3.2 / count)
    order = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert 3.8 < order < 4.3


OWN = {
    "hidden_mode.mass_x": 0.1, "hidden_mode.mass_y": 0.05, "hidden_mode.natural_frequency": 24.0,
    "hidden_mode.damping_ratio": 0.03, "lag.stiffness_x": 500.0, "lag.stiffness_y": 800.0,
    "lag.time_constant": 0.01,
}  # fmt: skip


@pytest.mark.parametrize("effects", [("gyroscopic", "cubic_stiffness"), ("hidden_mode", "lag")])
def test_sensitivities_agree_with_central_differences(effects):
    """Initial states projected out, those that effects bring among them."""
    study, values, columns = _study(duration=0.3, effects=effects)
    for key in set(OWN) & set(study.keys):
        values[0, study.index(key)] = OWN[key]
    layouts = layouts_for(study, 64, (None,))
    point = _point(study, values, layouts)
    series = study.series[0]
    scale = np.maximum(np.abs(values[0]), 1e-2)
    if "cubic_stiffness.stiffness" in study.keys:
        scale[study.index("cubic_stiffness.stiffness")] = 1e9
    rates = [
        n.endswith(("_rate", "velocity_x", "velocity_y")) for n in study.compiled.traced.states
    ]
    grams = reduce_windows(study, layouts, point, columns).triangle

    def shoot(row):
        return residuals(study, layouts, replace(point, values=row[None, :]))[0]

    matrix = []
    for i in range(columns.count):
        d = 1e-5 * scale[i] * np.eye(columns.count)[i]
        matrix.append(-((shoot(values[0] + d) - shoot(values[0] - d)) / (2e-5 * scale[i])).ravel())
    starts = []
    for window in range(len(layouts[0].starts)):
        for state, rate in enumerate(rates):
            move = np.zeros_like(point.starts[0])
            size = 1e-4 if rate else 1e-6
            move[window, state] = size
            up = residuals(study, layouts, replace(point, starts=(point.starts[0] + move,)))[0]
            down = residuals(study, layouts, replace(point, starts=(point.starts[0] - move,)))[0]
            starts.append(-((up - down) / (2 * size)).ravel())
    full = np.column_stack([*starts, *matrix, residuals(study, layouts, point)[0].ravel()])
    full /= np.linalg.norm(full, axis=0)
    nuisance = np.linalg.qr(full[:, : len(starts)])[0]
    rest = full[:, len(starts) :] - nuisance @ (nuisance.T @ full[:, len(starts) :])
    dense = rest.T @ rest
    ours = grams.T @ grams
    size = np.sqrt(np.diag(dense) / np.diag(ours))
    np.testing.assert_allclose(ours * np.outer(size, size), dense, atol=2e-6 * np.diag(dense).max())
    assert series.samples == 301


def test_reduction_does_not_depend_on_the_piece_it_is_made_in(monkeypatch):
    study, values, columns = _study(duration=2.0)
    layouts = layouts_for(study, 2001, (None,))
    point = _point(study, values, layouts)
    whole = reduce_windows(study, layouts, point, columns, 128)
    monkeypatch.setattr(sensitivities, "_PIECE", 256)
    pieces = reduce_windows(study, layouts, point, columns, 128)
    norms = np.linalg.norm(whole.triangle, axis=0)
    np.testing.assert_allclose(
        np.abs(pieces.triangle) / norms, np.abs(whole.triangle) / norms, atol=1e-9
    )
    assert pieces.cost == pytest.approx(whole.cost, rel=1e-12)


def test_blocks_add_up_to_the_whole_reduction():
    study, values, columns = _study(duration=2.0)
    for length in (64, 256, 2001):
        layouts = layouts_for(study, length, (None,))
        reduction = reduce_windows(study, layouts, _point(study, values, layouts), columns, 128)
        total = reduction.blocks.grams.sum(axis=0)
        dense = reduction.triangle.T @ reduction.triangle
        size = np.sqrt(np.outer(np.diag(dense), np.diag(dense)))
        np.testing.assert_allclose(total / size, dense / size, atol=1e-8)


def test_an_unseen_direction_of_the_initial_state_is_left_alone():
    # A free mass under a known force, position unseen: no window can tell the position.
    triangle = np.zeros((1, 3, 3))
    triangle[0] = [[1.0, 0.0, 2.0], [0.0, 0.0, 3.0], [0.0, 0.0, 1.0]]
    rows, eliminated, rank = eliminate_initial_states(triangle, 2)
    assert rank == 1
    assert np.linalg.norm(rows) == pytest.approx(np.sqrt(10.0))
    assert np.isfinite(eliminated).all()


def test_a_fit_recovers_noise_free_parameters():
    record = planar_record(0, noise=0.0, duration=3.0)
    study, values, columns = _study(duration=3.0, effects=())
    record = replace(record, noise={"x": 1e-9, "y": 1e-9})
    study = replace(study, series=(prepare_series(PlanarRotor(), record, 2),))
    layouts = layouts_for(study, 256, (None,))
    start = values * 1.03
    limits = (np.full(columns.count, -np.inf), np.full(columns.count, np.inf))
    fitted = fit(study, layouts, _point(study, start, layouts), columns, limits)
    assert fitted.converged
    np.testing.assert_allclose(fitted.point.values, values, rtol=2e-5)


def test_bounds_hold():
    study, values, columns = _study(duration=1.0, effects=())
    low = np.full(columns.count, -np.inf)
    low[study.index("linear_stiffness.stiffness_x")] = 8500.0
    layouts = layouts_for(study, 256, (None,))
    start = values.copy()
    start[0, study.index("linear_stiffness.stiffness_x")] = 9000.0
    fitted = fit(
        study,
        layouts,
        _point(study, start, layouts),
        columns,
        (low, np.full(columns.count, np.inf)),
    )
    reached = fitted.point.values[0, study.index("linear_stiffness.stiffness_x")]
    assert reached == pytest.approx(8500.0)


def test_partial_f_is_that_of_ordinary_least_squares():
    import statsmodels.api as sm

    study, values, _ = _study(duration=0.8)
    keys = [
        "linear_stiffness.stiffness_x",
        "linear_damping.damping_x",
        "gyroscopic.coefficient",
        "cubic_stiffness.stiffness",
    ]
    columns = ParameterColumns(np.array([study.index(k) for k in keys]), np.full(4, -1))
    layouts = layouts_for(study, 801, (None,))
    point = _point(study, values, layouts)
    table = build_score_table(reduce_windows(study, layouts, point, columns), 2)
    ours = score(table, (0, 1), (False, False))
    # the same regression, dense: columns from differences of the residuals
    matrix = []
    for k in keys:
        size = 1e8 if k.startswith("cubic") else 1e-3 * max(abs(values[0, study.index(k)]), 1e-2)
        ends = []
        for sign in (1, -1):
            row = values.copy()
            row[0, study.index(k)] += sign * size
            ends.append(residuals(study, layouts, replace(point, values=row))[0].ravel())
        matrix.append((ends[1] - ends[0]) / (2 * size))
    for state in range(4):
        size = 1e-6 if state < 2 else 1e-4
        ends = []
        for sign in (1, -1):
            move = point.starts[0].copy()
            move[0, state] += sign * size
            ends.append(residuals(study, layouts, replace(point, starts=(move,)))[0].ravel())
        matrix.append((ends[1] - ends[0]) / (2 * size))
    matrix = np.column_stack(matrix)
    matrix /= np.linalg.norm(matrix, axis=0)
    target = residuals(study, layouts, point)[0].ravel()
    large = sm.OLS(target, matrix).fit()
    small = sm.OLS(target, matrix[:, [0, 1, 4, 5, 6, 7]]).fit()
    expected = large.compare_f_test(small)[0]
    assert ours.statistic == pytest.approx(expected, rel=1e-4)


def test_covariance_is_the_inverse_of_the_information():
    study, values, columns = _study(duration=1.0, effects=())
    layouts = layouts_for(study, 256, (None,))
    limits = (np.full(columns.count, -np.inf), np.full(columns.count, np.inf))
    fitted = fit(study, layouts, _point(study, values, layouts), columns, limits)
    information = fitted.reduction.triangle[:-1, :-1].T @ fitted.reduction.triangle[:-1, :-1]
    product = covariance(fitted) @ information
    np.testing.assert_allclose(product, np.eye(columns.count), atol=1e-6)


def test_windows_cover_what_the_mask_holds_and_nothing_twice():
    for samples in (500, 1000, 14001):
        block = block_length(samples)
        for mask in (None, *halves(samples, block)):
            for length in stage_lengths(samples, block):
                layout = cut_windows(samples, length, mask)
                covered = np.zeros(samples, dtype=int)
                for start, size in zip(layout.starts, layout.lengths, strict=True):
                    covered[start : start + size] += 1
                assert covered.max() == 1
                assert np.all(covered[mask if mask is not None else slice(None)] == 1)


def test_windows_of_a_trajectory_agree_with_one_run():
    study, values, _ = _study(duration=1.0)
    one = layouts_for(study, 1001, (None,))
    point = _point(study, values, one)
    states, readings = run_windows(study, 0, one[0], point)
    many = layouts_for(study, 64, (None,))
    pieces = run_windows(study, 0, many[0], Point(values, (states[many[0].starts],)))[1]
    np.testing.assert_allclose(pieces, readings, rtol=1e-9, atol=1e-15)


def test_a_point_of_another_study_is_refused_before_compiled_loops_see_it():
    study = _study()[0]
    wide = Point(np.ones((1, len(study.keys))), (np.zeros((1, study.state_count + 1)),))
    narrow = Point(np.ones((1, len(study.keys) - 1)), (np.zeros((1, study.state_count)),))
    for point in (wide, narrow):
        with pytest.raises(ValueError, match="a point of 1 records"):
            point.check_study(study)

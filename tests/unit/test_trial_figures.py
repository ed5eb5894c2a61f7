"""A candidate's force beside the missing one, and words beside a doubtful coefficient."""

import numpy as np

from spiral.app.panels import sign_warnings
from spiral.view.report.text import coefficients_table
from spiral.view.report.trial import missing_force_comparison


def test_the_state_that_a_missing_force_follows_is_the_axis_of_its_second_panel():
    rng = np.random.default_rng(0)
    time = np.arange(2000) / 500
    x, v = 1e-3 * np.sin(9 * time), 1e-3 * 9 * np.cos(9 * time)
    force = (-300 * v + 1e-4 * rng.normal(size=2000))[:, None]
    spread = np.full((2000, 1), 1e-4)
    figure = missing_force_comparison(time, force, spread, 0.9 * force, force, ("x",), "N",
                          {"x": ("m", x), "x_rate": ("m/s", v)})  # fmt: skip
    assert figure.layout.xaxis2.title.text == "x' (mm/s)"
    curves = {t.name: t for t in figure.data if t.xaxis == "x2"}
    assert set(curves) == {"missing", "alone", "with its refit"}
    np.testing.assert_allclose(curves["alone"].y, 0.9 * np.array(curves["missing"].y), rtol=1e-5)


def test_a_state_that_never_moves_is_followed_by_nothing():
    time = np.arange(200) / 100
    force = 2 * np.sin(9 * time)[:, None]
    figure = missing_force_comparison(time, force, 0.1 * force, force, force, ("x",), "N",
                          {"still": ("m", np.zeros(200)), "x": ("m", force[:, 0])})  # fmt: skip
    assert figure.layout.xaxis2.title.text == "x (m)"


def test_words_stand_beside_the_value_they_are_about():
    damping = {"estimate": -4.0, "se": 0.1, "t": -40.0, "unit": "N*s/m"}
    model = {"effects": {"linear_damping": {"damping": damping}}, "system": {}}
    table = coefficients_table({"model": model}, (), {"linear_damping.damping": "feeds <energy>"})
    assert "damping (feeds &lt;energy&gt;)" in table
    assert sign_warnings({}) == ""
    assert "<energy>" not in sign_warnings({"linear_damping.damping": "<energy>"})

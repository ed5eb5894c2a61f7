"""Known values that are a little off, and effects that explain no more."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lsim

import spiral
from spiral.inference.likelihood.tolerances import TOLERANCE, Tolerances, tolerances_of
from spiral.inference.problem import DECISIVE_ODDS, silent
from spiral.types.record import make_record


def ranking(columns, target, labels):
    """A ranking of changes of known values and one force, as far as tolerances ask of it."""
    from spiral_plugins.effects.restoring import CubicStiffness
    from spiral_plugins.effects.varying import OtherValue

    effects = [OtherValue(port=x) if x else CubicStiffness() for x in labels]
    ranked = tuple(
        SimpleNamespace(variant=SimpleNamespace(original=e), columns=(i,))
        for i, e in enumerate(effects)
    )
    return SimpleNamespace(
        ranked=ranked, table=SimpleNamespace(triangle=columns, target=target)
    )  # fmt: skip


def test_what_known_values_explain_is_the_most_likely_under_their_prior():
    rng = np.random.default_rng(0)
    a, e = rng.normal(size=(40, 3)) * 600, rng.normal(size=40)
    e = e + a[:, 0] * 0.004
    told = tolerances_of(ranking(a, e, ["m", "k", ""]))
    errors = np.array([x for _, x in told.errors])

    def height(d):
        return -0.5 * np.sum((e - a[:, :2] @ d) ** 2) - 0.5 * np.sum((d / TOLERANCE) ** 2)

    assert [name for name, _ in told.errors] == ["m", "k"]
    assert told.log_likelihood == pytest.approx(height(errors) - height(np.zeros(2)))
    for step in 1e-4 * np.eye(2):
        assert height(errors + step) < height(errors) > height(errors - step)
    assert tolerances_of(ranking(a, e, ["", "", ""])) == Tolerances()


def test_an_effect_must_be_likelier_by_the_odds_where_known_values_are_off():
    odds = np.log(DECISIVE_ODDS)
    known = Tolerances(9.0, (("C", 0.0043), ("L", -0.0022)))
    assert "C by 0.430 %, L by 0.220 %" in known.refuses(9.0 + 0.9 * odds)
    assert not known.refuses(9.0 + 1.1 * odds)
    assert not Tolerances(0.9 * odds).refuses(0.1)


def resonator(share, noise):
    """A known mass on a known spring; the mass is off by ``share``, readings by ``noise``."""
    system = spiral.system(
        ["m*x'' + c*x' + k*x = F"], states={"x": "m"}, observed=["x"],
        inputs={"F": {"unit": "N", "interpolation": "zero_order"}},
        parameters={"m": (2.0, "kg"), "c": (3.0, "N*s/m"), "k": (2000.0, "N/m")}, free=["c"],
    )  # fmt: skip
    rng = np.random.default_rng(4)
    time, force = 0.01 * np.arange(1600), np.repeat(rng.normal(size=160), 10)
    mass = 2.0 * (1 + share)
    x = lsim(([1 / mass], [1, 3.0 / mass, 2000.0 / mass]), force, time, interp=False)[1]
    x = x + noise * x.std() * rng.normal(size=len(x))
    return make_record(system, "resonator", time, {"x": x}, {"F": force}), system


@pytest.mark.parametrize(
    ("share", "noise", "missing"),
    [(0.001, 0.02, ()), (0.003, 0.02, ("other_value@m",)), (0.03, 0.02, ("other_value@m",))],
)
def test_a_mass_that_is_off_is_told_as_that_and_as_nothing_else(share, noise, missing):
    """A small mode, or a spring, would do as well as three tenths of a percent of the mass."""
    record, system = resonator(share, noise)
    offered = ["other_value@m", "other_value@k", "linear_stiffness", "cubic_stiffness",
               "quadratic_damping", "hidden_mode"]  # fmt: skip
    run = spiral.discover(record, system, candidates=offered, progress=silent)
    assert run.missing == missing

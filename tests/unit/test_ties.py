"""Which parameters take part in a combination that records cannot tell."""

from types import SimpleNamespace

import numpy as np

from spiral.inference.likelihood.tied_parameters import find_parameter_ties

KEYS = ("spring.stiffness", "leak.rate", "spring.damping", "system.mass")


def _found(values, columns):
    estimate = SimpleNamespace(
        finite=True, keys=KEYS, values=dict(zip(KEYS, values, strict=True)),
        predictions=(SimpleNamespace(columns=columns),),
        covariance=np.full((4, 4), np.inf),
    )  # fmt: skip
    return SimpleNamespace(estimate=estimate)


def _columns(rng, tied):
    """Slopes by four parameters; the first three in a plane where they are tied."""
    x = rng.normal(size=(500, 4))
    if tied:
        x[:, 2] = (x[:, 0] * 400.0 - x[:, 1] * 8.0) / 60.0
    return x


def test_a_parameter_near_zero_does_not_hide_those_that_it_is_tied_to():
    """In relative changes the damping of 3 has all of the flat combination but a seventh."""
    rng = np.random.default_rng(0)
    ties = find_parameter_ties(_found((400.0, 8.0, 3.0, 2.0), _columns(rng, True)))
    assert set(ties.parts) == {"spring.stiffness", "leak.rate", "spring.damping"}
    assert ties.groups == (("leak", "spring"),)


def test_parameters_with_slopes_of_their_own_are_not_tied():
    ties = find_parameter_ties(
        _found((400.0, 8.0, 3.0, 2.0), _columns(np.random.default_rng(0), False))
    )
    assert not ties


def test_slopes_that_overflow_tie_nothing():
    """The spectrum of what is not finite is none; a study goes on."""
    columns = _columns(np.random.default_rng(0), True)
    columns[3, 1] = np.inf
    assert not find_parameter_ties(_found((400.0, 8.0, 3.0, 2.0), columns))

"""Learners: they learn, stop early, and give the same function for the same seed."""

import numpy as np
import pytest

from spiral.types.errors import InputError
from spiral.types.learner import learned
from tests.scenes import registry


def surface(seed=0, n=3000, noise=0.0):
    rng = np.random.default_rng(seed)
    xi = rng.normal(size=(n, 3)) * [1e-4, 1e-2, 100.0]
    unit = xi / [1e-4, 1e-2, 100.0]
    r = np.column_stack([np.tanh(unit[:, 0]) * 50, unit[:, 1] * unit[:, 2]])
    train = rng.random(n) < 0.7
    return xi, r + noise * rng.normal(size=r.shape) * r.std(axis=0), train


def test_every_shipped_learner_has_a_test():
    assert set(registry().names("learner")) == {"boosted_trees", "tanh_network"}


@pytest.mark.parametrize(
    ("name", "fields", "left"),
    [("tanh_network", {"epochs": 40}, 0.02), ("boosted_trees", {"trees": 60}, 0.15)],
)
def test_a_learner_follows_a_function_of_several_outputs(name, fields, left):
    learner = registry().make("learner", name, fields)
    xi, r, train = surface()
    told = []
    once = learned(learner, xi, r, train, 1, told.append)
    assert once.log["validation_left"] < left
    assert once.predict(xi).shape == r.shape
    again = learned(learner, xi, r, train, 1)
    assert np.array_equal(once.predict(xi), again.predict(xi))
    assert told
    if name == "tanh_network":
        other = learned(learner, xi, r, train, 2)
        assert not np.array_equal(once.predict(xi), other.predict(xi))


def test_a_network_stops_before_it_learns_the_noise():
    learner = registry().make("learner", "tanh_network", {"epochs": 80, "patience": 4})
    xi, r, train = surface(n=400, noise=2.0)
    found = learned(learner, xi, r, train, 0)
    assert found.log["stopped_early"]
    assert found.log["epochs"] < 80


def test_nothing_to_learn_from_is_refused():
    learner = registry().make("learner", "boosted_trees")
    xi, r, train = surface(n=50)
    with pytest.raises(InputError, match="train"):
        learned(learner, xi, r, np.ones_like(train), 0)
    with pytest.raises(InputError, match="finite"):
        learned(learner, xi, r * np.nan, train, 0)

"""Random forces that look alike: on a hidden store, on a group, on one state, with a memory."""

import numpy as np
import pytest
from scipy.signal import lfilter

import spiral
from spiral.engine.likelihood.noise import NoiseModel, NoiseTerm
from spiral.inference.disturbances import random_forces
from spiral.inference.likelihood.fitting import fit_by_likelihood, largest_force
from spiral.inference.likelihood.smaller_forces import half_as_large, replace_large_forces
from spiral.inference.problem import silent
from spiral.inference.rounds import strategy_for
from spiral.types.record import make_record

AREA, STORE, LOSS, LINK = 2.5e5, 2.2e6, 0.9, 0.12
TIME, DT = 2e4, 600.0


def _lake():
    """A lake that is measured, and the ground water beside it, which hardly moves."""
    unit = {"A": "m^2", "G": "m^2", "kl": "m^2/s", "kg": "m^2/s"}
    given = {"A": AREA, "G": 2e6, "kl": 1.0, "kg": 0.13}
    return spiral.system(
        ["h' = (0.7*q + kg*(b - h) - kl*h)/A", "b' = (0.3*q - kg*(b - h))/G"],
        states={"h": "m", "b": {"unit": "m", "like": "h"}}, inputs={"q": "m^3/s"}, observed=["h"],
        parameters={k: {"value": v, "unit": unit[k]} for k, v in given.items()},
        free=["G", "kl", "kg"],
    )  # fmt: skip


def _record(system, seed, count=2000, more=1.0):
    """An inflow that nobody measured, correlated over 2e4 s, acts on the lake."""
    rng = np.random.default_rng(seed)
    rain = np.clip(np.repeat(rng.uniform(-2.2, 3.0, count // 50), 50), 0, None)
    keep = np.exp(-DT / TIME)
    push = 0.05 * more * lfilter([np.sqrt(1 - keep**2)], [1, -keep], rng.normal(size=count))
    x, level = np.array([0.5, 1.2]), np.empty(count)
    for k in range(count):
        level[k] = x[0]
        for _ in range(10):
            h, b = x
            into = 0.7 * rain[k] + LINK * (b - h) - LOSS * h + push[k]
            x = x + DT / 10 * np.array([into / AREA, (0.3 * rain[k] - LINK * (b - h)) / STORE])
    level += 0.01 * level.std() * rng.normal(size=count)
    return make_record(system, "lake", DT * np.arange(count), {"h": level}, {"q": rain},
                       hold={"q": "zero_order"})  # fmt: skip


@pytest.fixture(scope="module")
def study():
    """The study's beginning, and its fit with a force on the hidden store alone."""
    system = _lake()
    run = spiral.discover(_record(system, 1), system, candidates=["linear_loss@h"])
    strategy = strategy_for(run.question)
    begun = strategy.begin(run.question, silent)
    assembly, state = begun.assembly, begun.fit_state
    noise = NoiseModel(
        (NoiseTerm("white", "h"), NoiseTerm("force", "hidden")),
        {"white.h": 0.003, "force.hidden": 0.5},
    )
    return assembly, fit_by_likelihood(assembly, state, noise, rough=True)


@pytest.mark.slow
def test_a_small_force_with_a_memory_takes_the_place_of_a_large_one_on_a_store(study):
    """White on the store it has to be as large as the store's own rate; the true one is small."""
    assembly, large = study
    assert largest_force(large.estimate.noise) > assembly.problem.settings.random_limit
    found = replace_large_forces(assembly, large, silent)
    assert found is not None
    assert found.log_likelihood > large.log_likelihood - np.log(100.0)
    assert largest_force(found.estimate.noise) <= assembly.problem.settings.random_limit
    names = {t.size for t in found.estimate.noise.terms if t.kind in ("force", "gust")}
    assert names & {"gust.h", "gust.observed"}
    time = found.estimate.noise.values["gust.time"]  # of 48 such times: told to about a third
    assert TIME / 2 < time < 2 * TIME


def test_nothing_takes_the_place_of_a_force_that_is_small(study):
    assembly, large = study
    found = replace_large_forces(assembly, large, silent)
    assert found is not None
    assert replace_large_forces(assembly, found, silent) is None


def test_a_force_gives_way_to_one_of_half_its_size_where_none_is_small():
    """As large as a limit in any case; half of what stands there, where that is more."""
    noise = NoiseModel((NoiseTerm("force", "hidden"),), {"force.hidden": 1.0})
    assert half_as_large(noise, 0.2) == 0.5
    assert half_as_large(noise.with_values({"force.hidden": 0.3}), 0.2) == 0.2


@pytest.mark.slow
def test_an_inflow_of_a_quarter_of_the_lakes_own_is_told_with_its_size():
    """Five times as large as in the record above: no force that explains, and no 100 %."""
    system = _lake()
    run = spiral.discover(_record(system, 3, more=5.0), system)
    assert run.missing == ()
    assert max(random_forces(run.final).values()) < 0.5


@pytest.mark.slow
def test_a_lake_with_an_unmeasured_inflow_lacks_nothing():
    system = _lake()
    run = spiral.discover(_record(system, 2), system)
    assert run.verdict == "nothing_missing"
    assert max(random_forces(run.final).values()) < 0.2
    assert not any(name.endswith("hidden") for name in random_forces(run.final))

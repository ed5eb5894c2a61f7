"""Random forces that look alike: on a hidden store, on a group, on one state, with a memory."""

import numpy as np
import pytest
from scipy.signal import lfilter

import spiral
from spiral.engine.likelihood.noise import NoiseModel, NoiseTerm
from spiral.inference.disturbances import random_forces
from spiral.inference.likelihood.fitting import fit_by_likelihood, largest_force
from spiral.inference.likelihood.smaller_forces import replace_large_forces
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


def _record(system, seed, count=2000):
    """An inflow that nobody measured, correlated over 2e4 s, acts on the lake."""
    rng = np.random.default_rng(seed)
    rain = np.clip(np.repeat(rng.uniform(-2.2, 3.0, count // 50), 50), 0, None)
    keep = np.exp(-DT / TIME)
    more = 0.05 * lfilter([np.sqrt(1 - keep**2)], [1, -keep], rng.normal(size=count))
    x, level = np.array([0.5, 1.2]), np.empty(count)
    for k in range(count):
        level[k] = x[0]
        for _ in range(10):
            h, b = x
            into = 0.7 * rain[k] + LINK * (b - h) - LOSS * h + more[k]
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


def _cold_store():
    """Coil, air, goods and walls, of which goods and walls are hidden."""
    unit = {"Ce": "J/K", "Ca": "J/K", "Cg": "J/K", "Cw": "J/K", "UA": "W/K", "hg": "W/K",
            "hw": "W/K", "ho": "W/K", "Pf": "W"}  # fmt: skip
    given = {"Ce": 42e3, "Ca": 6.2e5, "Cg": 5e6, "Cw": 1.2e6, "UA": 350.0, "hg": 250.0, "hw": 150.0,
             "ho": 68.0, "Pf": 180.0}  # fmt: skip
    return spiral.system(
        ["Ce*Te' = UA*(Ta - Te) - P",
         "Ca*Ta' = UA*(Te - Ta) + hg*(Tg - Ta) + hw*(Tw - Ta) + Pf",
         "Cg*Tg' = hg*(Ta - Tg)", "Cw*Tw' = hw*(Ta - Tw) + ho*(To - Tw)"],
        states={"Te": {"unit": "K", "start": 268.0}, "Ta": {"unit": "K", "start": 270.0},
                "Tg": {"unit": "K", "start": 271.0}, "Tw": {"unit": "K", "start": 274.0}},
        inputs={"P": {"unit": "W", "interpolation": "zero_order"}, "To": "K"},
        parameters={k: {"value": v, "unit": unit[k]} for k, v in given.items()},
        observed=["Te", "Ta"], free=["Cg", "Cw", "UA", "hg", "hw", "ho"],
    )  # fmt: skip


def _through_doors(system, seed, heat=90.0, count=2400, dt=60.0):
    """Heat through doors, smooth over some minutes, which nobody logged, acts on the air."""
    rng, steps = np.random.default_rng(seed), 60
    power = np.repeat(rng.uniform(0, 2200, count // 40), 40)
    outside = 290 + 6 * np.sin(2 * np.pi * np.arange(count) * dt / 86400)
    doors = lfilter([1.0], [1.0, -0.9], lfilter([1.0], [1.0, -0.8], rng.normal(size=count)))
    doors *= heat / doors.std()
    x, seen = np.array([268.0, 270.0, 271.0, 274.0]), []
    for k in range(count):
        seen.append(x[:2])
        for _ in range(steps):
            e, a, g, w = x
            into = 380 * (e - a) + 230 * (g - a) + 170 * (w - a) + 180 + doors[k]
            rates = [(380 * (a - e) - power[k]) / 42e3, into / 6.2e5, 230 * (a - g) / 4.6e6,
                     (170 * (a - w) + 62 * (outside[k] - w)) / 1.3e6]  # fmt: skip
            x = x + dt / steps * np.array(rates)
    seen = np.array(seen)
    seen = seen + 0.01 * seen.std(axis=0) * rng.normal(size=seen.shape)
    channels = {"Te": seen[:, 0], "Ta": seen[:, 1]}
    inputs = {"P": power, "To": outside}
    return make_record(system, "store", dt * np.arange(count), channels, inputs)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_heat_through_doors_acts_on_the_air_and_nothing_is_missing(seed):
    """No flow as large as a hidden store's own, and none of no size that follows the weather."""
    system = _cold_store()
    run = spiral.discover(_through_doors(system, seed), system)
    assert run.missing == ()
    assert not run.final.contradictions
    assert max(random_forces(run.final).values()) < 0.5
    assert "is no chance" not in run.summary


@pytest.mark.slow
def test_a_lake_with_an_unmeasured_inflow_lacks_nothing():
    system = _lake()
    run = spiral.discover(_record(system, 2), system)
    assert run.verdict == "nothing_missing"
    assert max(random_forces(run.final).values()) < 0.2
    assert not any(name.endswith("hidden") for name in random_forces(run.final))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nothing_is_named_beside_much_heat_that_is_smooth(seed):
    """A flow of 60 % of the machine's own stands for nothing that a catalog has."""
    system = _cold_store()
    run = spiral.discover(_through_doors(system, seed, heat=250.0), system)
    assert run.missing == ()
    assert not run.final.model.labels
    forces = random_forces(run.final)
    assert {*forces} == {"gust.Ta"}
    assert forces["gust.Ta"] < 0.8

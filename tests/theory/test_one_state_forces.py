"""A random force on one state of several, and what a random force no longer has to do."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import spiral
from spiral.engine.filter.noise import noise_intensity
from spiral.engine.filter.setup import choose_levels, prepare_filter
from spiral.engine.filter.task import prepare_task
from spiral.inference.disturbances import random_forces
from spiral.inference.strategies.likelihood.benefit import _force_replacement_share
from spiral.types.errors import ConfigError
from spiral.types.horizon import Horizon
from spiral.types.model import seed_model
from spiral.types.record import make_record
from spiral.types.run import Comparison
from tests.scenes import effect, registry

EQUATIONS = ["w' = k*u - a*w", "v' = b*w - c*v"]
TRUTH = {"k": 2.0, "a": 0.8, "b": 1.5, "c": 0.6}


def _system():
    units = {"k": "rad/s^2/V", "a": "1/s", "b": "1/s", "c": "1/s"}
    off = {"k": 1.1, "a": 0.9, "b": 1.12, "c": 0.88}
    return spiral.system(
        EQUATIONS, states={"w": "rad/s", "v": "rad/s"}, inputs={"u": "V"}, observed=["w", "v"],
        parameters={n: {"value": x * off[n], "unit": units[n]} for n, x in TRUTH.items()},
        free=list(TRUTH),
    )  # fmt: skip


def _disturbed(system, seed=3, dt=0.04, count=3000, time=0.4):
    """Both measured with 1 % noise; a torque correlated over 0.4 s pushes w alone."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, count // 50), 50)
    keep = np.exp(-dt / time)
    d = lfilter([np.sqrt(1 - keep**2)], [1, -keep], rng.normal(size=count)) * 0.12
    x, rows = np.zeros(2), []
    a = np.array([[-TRUTH["a"], 0.0], [TRUTH["b"], -TRUTH["c"]]])
    for k in range(count):
        rows.append(x)
        for _ in range(20):
            x = x + dt / 20 * (a @ x + np.array([TRUTH["k"] * u[k] + d[k], 0.0]))
    y = np.array(rows)
    y = y + 0.01 * y.std(axis=0) * rng.normal(size=y.shape)
    return make_record(
        system, "disturbed", dt * np.arange(count), {"w": y[:, 0], "v": y[:, 1]}, {"u": u},
        hold={"u": "zero_order"},
    )  # fmt: skip


@pytest.mark.slow
def test_what_pushes_one_state_is_told_there_with_its_time():
    system = _system()
    run = spiral.discover(_disturbed(system), system)
    assert run.verdict == "nothing_missing"
    forces = random_forces(run.final)
    assert "gust.w" in forces
    assert not any(name.endswith((".v", ".observed")) for name in forces)
    assert run.final.random_times["gust.w"] == pytest.approx(0.4, rel=0.35)
    assert "a random flow acts on w:" in run.summary.lower()


OSCILLATOR = seed_model(registry().make("system", "oscillator"))


def _compared(force, fit, test, *effects):
    unseen = (Horizon("free_run", None, None, {"x": (test**2,) * 20}),)
    model = OSCILLATOR
    for one in effects:
        model = model.add(one)
    found = Comparison(model, fit, test, {}, 0.02, 1.0, 0.4, 0.003, 1024, True)
    return replace(found, unseen=unseen, random={"force.hidden": force})


def test_a_random_force_is_replaced_by_the_share_of_it_that_is_gone():
    """2 -> 1 is a half, where both free runs improve: by a quarter of what is left, in squares."""
    before, cubic = _compared(0.2, 0.10, 0.20), effect("cubic_stiffness")
    after = _compared(0.1, 0.05, 0.10, cubic)
    assert _force_replacement_share(before, after) == pytest.approx(0.5)
    nearly = _compared(0.1, 0.05, 0.193, cubic)
    assert _force_replacement_share(before, nearly) == pytest.approx(0.5)
    assert _force_replacement_share(before, _compared(0.1, 0.05, 0.195, cubic)) == 0.0
    assert _force_replacement_share(before, _compared(0.1, 0.05, 0.25, cubic)) == 0.0
    assert _force_replacement_share(before, _compared(0.2, 0.05, 0.10, cubic)) == 0.0


def test_a_force_with_a_memory_of_its_own_counts_for_nothing_there():
    before = _compared(0.2, 0.10, 0.20)
    assert (
        _force_replacement_share(before, _compared(0.1, 0.05, 0.10, effect("hidden_mode"))) == 0.0
    )


def test_a_filter_takes_levels_of_groups_and_of_single_states():
    """q of a state is level^2 times its scale and the scale of its rate, whoever names it."""
    system = _system()
    task = prepare_task(seed_model(system, values={f"system.{k}": v for k, v in TRUTH.items()}),
                        _disturbed(system, count=400))  # fmt: skip
    both = noise_intensity(task, {"observed": 0.1})
    one = noise_intensity(task, choose_levels(task, prepare_filter(task)[1], {"w": 0.1}))
    assert one == pytest.approx([both[0], 0.0])
    with pytest.raises(ConfigError, match="process_noise of 'nowhere'"):
        choose_levels(task, prepare_filter(task)[1], {"nowhere": 0.1})

"""Free runs begin hidden states where the fitted records show them beside the measured ones."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import spiral
from spiral.inference.likelihood import free_run_starts
from spiral.inference.likelihood.free_run_starts import UsualStates
from spiral.types.record import make_record


def _joint():
    """A motor and a link behind a stiffening gear; neither has a place of its own."""
    return spiral.system(
        [
            "J*q'' + d*q' + c*(q' - l') + k*(q - l) + h*(q - l)**3 = u",
            "L*l'' + b*l' + c*(l' - q') + k*(l - q) + h*(l - q)**3 = 0",
        ],
        states={"q": "rad", "l": "rad"}, inputs={"u": "N*m"}, observed=["q"], free=["d", "k"],
        parameters={
            "J": "0.9 kg*m^2", "L": "1.6 kg*m^2", "d": "7 N*m*s/rad", "b": "1.5 N*m*s/rad",
            "c": "5 N*m*s/rad", "k": "4400 N*m/rad", "h": "6e6 N*m/rad^3",
        },
    )  # fmt: skip


def _record(system, seed, place):
    """A multisine, both at ``place`` in rad and at rest before; noise of 0.0001 rad."""
    time, rng = np.arange(1200) / 500, np.random.default_rng(seed)
    lines, turns = np.linspace(0.5, 20, 40), rng.uniform(0, 2 * np.pi, 40)

    def torque(t):
        return 5 * np.sum(np.cos(2 * np.pi * lines * t + turns))

    def rate(t, x):
        q, p, v, w = x
        force = 4200 * (q - p) + 6e6 * (q - p) ** 3 + 5 * (v - w)
        return [v, w, (torque(t) - 8 * v - force) / 0.9, (force - 1.5 * w) / 1.6]

    motion = solve_ivp(
        rate, (0, time[-1]), [place, place, 0, 0], t_eval=time, rtol=1e-9, atol=1e-12
    )
    angle = motion.y[0] + 1e-4 * rng.normal(size=len(time))
    return make_record(
        system, f"{seed}", time, {"q": angle}, {"u": np.array([torque(t) for t in time])}
    )


def test_a_test_elsewhere_is_predicted_as_well_as_the_fitted_record():
    """A hidden angle begun at its mean of the fit would wind the gear up by 0.6 rad."""
    system = _joint()
    result = spiral.compare(_record(system, 1, 0.6), system, test=_record(system, 2, -0.05))
    assert result.test_error <= 1.2 * result.noise_floor
    ahead = next(h for h in result.unseen if h.name == "one_sample")
    assert ahead.error <= 1.2 * result.noise_floor


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_hidden_states_are_the_conditional_mean(share):
    """Beside readings one deviation off: as much off as they go together."""
    hidden, slopes = np.array([False, True]), np.zeros((2, 2))
    slopes[1, 0] = share * 3.0
    usual = UsualStates(np.array([1.0, 10.0]), slopes, hidden)
    np.testing.assert_allclose(usual.beside(np.array([3.0, 0.0])), [3.0, 10.0 + share * 6.0])


def test_a_measured_state_that_does_not_move_tells_of_no_hidden_one(monkeypatch):
    """A pressure of some bar that stays as it is, beside one that nobody sees."""
    hidden = 3e5 + 1e5 * np.sin(np.arange(100.0))
    run = SimpleNamespace(whole=True, means=np.column_stack([np.full(100, 2e5), hidden]))
    monkeypatch.setattr(free_run_starts, "predict_readings", lambda *_, **__: run)
    traced = SimpleNamespace(channels=("p",))
    task = SimpleNamespace(states=("p", "q"), compiled=SimpleNamespace(traced=traced))
    usual = free_run_starts.usual_states(SimpleNamespace(prepared=[(task, None)], noise=None))
    np.testing.assert_allclose(usual.beside(np.array([5e5, 0.0])), [5e5, hidden.mean()])

"""``strategy=paper``: projected coefficients on true derivatives, how the loop ends, the log."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from spiral_plugins.libraries.core import Core
from spiral_plugins.libraries.projection import Projection
from spiral_plugins.strategies.paper import Paper
from spiral_plugins.systems.planar_rotor import PlanarRotor

from spiral.inference.discover import discover
from spiral.inference.strategies.paper import ENDED
from spiral.io.writing import to_json
from spiral.types.derivative import Derivative, Derivatives
from spiral.types.errors import ConfigError
from tests.scenes import PROJECTION, coastdown_problem, registry

REGISTRY = registry()
HIDDEN = ("cross_stiffness", "cubic_stiffness", "gyroscopic")


class Truth(Derivative):
    """What the simulation knows: y, y' and y'' = d(y')/dt of its states without noise."""

    record: Any = None

    def estimate(self, y, dt, speed=None):
        time, truth = self.record.time, self.record.truth
        rates = np.column_stack([truth["x_rate"], truth["y_rate"]])
        second = CubicSpline(time, rates).derivative()(time)
        return Derivatives(np.column_stack([truth["x"], truth["y"]]), rates, second, edge=5)


def problem(library, derivative="savitzky_golay", gates=None, named=None, sampling="box", **fields):
    base = coastdown_problem(**fields)
    estimator = derivative if isinstance(derivative, Derivative) else None
    if derivative == "truth":
        estimator = Truth(base.records[0])
    strategy = Paper(
        derivative=estimator or REGISTRY.make("derivative", derivative),
        learner=REGISTRY.make("learner", "tanh_network", {"epochs": 25}),
        library=library,
        sampling=sampling,
        points=20_000,
    )
    if gates is not None:
        strategy = replace(strategy, gate=tuple(REGISTRY.make("gate", g) for g in gates))
    offered = strategy.candidates(base.model, named)
    return replace(base, candidates=offered, strategy=strategy)


@pytest.fixture(scope="module")
def exact():
    """Noise-free record, true derivatives, and what the tilt leaves."""
    named = (*HIDDEN, "cross_damping")
    return discover(problem(Projection(order=3), "truth", named=named, noise_level=0.0))


def test_true_derivatives_give_the_projected_coefficients(exact):
    """Design, fact 3: to 1 %; the third order moves the gyroscopic one by 1.7 % itself."""
    values = exact.model.values
    assert set(HIDDEN) <= set(exact.model.labels)
    for key, expected in PROJECTION.items():
        assert values[key] == pytest.approx(expected, rel=0.02 if "gyro" in key else 0.01), key


def test_true_derivatives_give_the_third_order_to_a_thousandth(exact):
    predicted = {t.key: t.predicted for t in Projection(order=3).terms(PlanarRotor())}
    for key in PROJECTION:
        near = 5e-3 if "gyroscopic" in key else 1e-3
        assert exact.model.values[key] == pytest.approx(predicted[key], rel=near), key


def test_a_run_ends_in_a_model_and_a_record_of_its_rounds(exact):
    assert exact.verdict == "effect_missing"
    assert exact.stopped in ("whiteness", "no_candidate")
    data = json.loads(to_json(exact.as_dict()))
    assert data["rounds"][-1]["details"]["ended"]["text"] in ENDED.values()
    first = data["rounds"][0]["details"]
    assert {"ljung_box", "learner", "projection", "bonferroni_t", "correlation_cluster",
            "kfold_majority", "partial_f", "validation_rollback", "diagnostics", "coefficients",
            "admitted"} <= set(first)  # fmt: skip
    assert {"press", "vif", "adjusted_r2"} <= set(first["diagnostics"])
    admitted = first["admitted"]["gyroscopic.coefficient"]
    assert "1.778*polar_inertia" in admitted["mechanism"]
    assert admitted["predicted"] == pytest.approx(4.885e-3, rel=1e-3)
    assert len(admitted["by_equation"]) == 2
    assert {"t_ols", "t_hac"} <= set(admitted["by_equation"][0])
    assert data["rounds"][-1]["test_error"] < 0.05 < data["rounds"][0]["test_error"]


def test_the_same_seed_gives_the_same_run():
    question = problem(Core(), duration=3.0, start_hz=25.0, stop_hz=10.0)
    runs = [discover(question) for _ in range(2)]
    logs = [
        [(r.admitted, r.comparison.test_error, r.details.get("bonferroni_t")) for r in run.rounds]
        for run in runs
    ]
    assert logs[0] == logs[1]
    assert runs[0].model.values == runs[1].model.values


def test_gate_1_passes_everything_and_plain_t_is_many_times_the_robust_one(exact):
    """Design, facts 11 and 12; the guard cannot pass although nothing is measured with noise."""
    first = exact.rounds[0].details
    assert first["bonferroni_t"]["pass_rate"] == 1.0
    inflated = [abs(c["t_ols"] / c["t_hac"]) for c in first["coefficients"].values()]
    assert np.median(inflated) > 5
    assert not exact.rounds[-1].details.get("ljung_box", {"white": False})["white"]


@pytest.mark.parametrize("sampling", ["trajectory", "samples"])
def test_every_way_of_sampling_runs(sampling):
    question = problem(Core(), duration=3.0, start_hz=25.0, stop_hz=10.0, sampling=sampling)
    run = discover(question)
    assert run.rounds[0].details["bonferroni_t"]["tested"] == 6
    assert ("learner" in run.rounds[0].details) is (sampling == "trajectory")


def test_without_gates_everything_is_admitted():
    question = problem(Core(), gates=(), duration=3.0, start_hz=25.0, stop_hz=10.0)
    run = discover(question)
    assert set(run.rounds[1].details["coefficients"]) >= {
        t.key for t in Core().terms(PlanarRotor())
    }
    assert run.rounds[-1].details["ended"]["reason"] == "library_exhausted"


def test_only_admitted_amplitudes_move():
    """Of ``speed_damping`` the core has one amplitude; the others stay at zero."""
    run = discover(problem(Core(), gates=(), named=("speed_damping",), duration=3.0,
                           start_hz=25.0, stop_hz=10.0))  # fmt: skip
    assert run.rounds[1].admitted == ("speed_damping",)
    values = run.model.values
    assert values["speed_damping.symmetric"] != 0
    assert values["speed_damping.own_x"] == values["speed_damping.own_y"] == 0
    assert {"speed_damping.own_x", "speed_damping.own_y"} <= set(run.model.fixed)


def test_the_closure_is_reported_and_not_added():
    """A last resort of the paper's table: a term that no physical name can be given to."""
    library = REGISTRY.make("library", "paper")
    gates = ("bonferroni_t", "contribution")
    question = problem(library, gates=gates, named=("constant_load",), duration=3.0,
                       start_hz=25.0, stop_hz=10.0)  # fmt: skip
    run = discover(question)
    last = run.rounds[-1].details
    assert last["ended"]["reason"] == "no_term_passes_a_refinement"
    assert last["closure"]["rmse_after"] < last["closure"]["rmse_before"]
    assert run.model.labels == question.model.labels


def test_hidden_coordinates_cannot_be_differentiated():
    base, asked = coastdown_problem(duration=1.0), problem(Core(), duration=1.0)
    full = REGISTRY.make("system", "tilting_rotor")
    from spiral.inference.simulate import with_defaults
    from spiral.types.model import seed_model

    with pytest.raises(ConfigError, match="strategy=paper"):
        asked.strategy.begin(
            replace(
                asked, records=base.records, model=with_defaults(seed_model(full)), candidates=()
            ),
            lambda m: None,
        )


def test_a_run_is_taken_up_again_from_a_checkpoint():
    """Through JSON, with amplitudes that are held at zero."""
    from spiral.io.checkpoint import Checkpoint, _json_converter

    question = problem(Core(), gates=(), named=("speed_damping",), duration=3.0,
                       start_hz=25.0, stop_hz=10.0)  # fmt: skip
    kept: list[Checkpoint] = []
    run = discover(question, keep=kept.append)
    converter = _json_converter(REGISTRY)
    text = json.dumps(converter.unstructure(kept[1]))
    back = converter.structure(json.loads(text), Checkpoint)
    assert back.fit_state.held == ("speed_damping.own_x", "speed_damping.own_y")
    assert discover(question, resume=back).model.values == run.model.values

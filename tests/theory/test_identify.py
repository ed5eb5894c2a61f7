"""What a record can tell before any fit: the paper's bounds, its dichotomy, and the verb."""

from __future__ import annotations

import json

import numpy as np
import pytest
from spiral_plugins.sources.rotor_coastdown import RotorCoastdown
from spiral_plugins.systems.planar_rotor import PlanarRotor

from spiral.cli import main
from spiral.inference.identifiability.richness import (
    alias_groups,
    bias_bound,
    detection_margin,
    richness,
    samples_needed,
    snr_min,
    spread_bound,
)
from spiral.inference.identifiability.signatures import signatures
from spiral.types.model import seed_model
from tests.scenes import registry

STEADY = (
    "record=simulation", "record.system=tilting_rotor", "record.duration=8",
    "record.inputs={speed: {constant: 12, unit: Hz}}", "test=null", "derivative=kalman_smoother",
)  # fmt: skip
FEW = "candidates=[gyroscopic,cubic_stiffness,cross_stiffness,speed_stiffness]"


def _columns(rng: np.random.Generator, count: int = 400) -> np.ndarray:
    """Four columns of unit rms, two of them with a cosine of about 0.95."""
    phi = rng.normal(size=(count, 4))
    phi[:, 3] = phi[:, 2] + 0.3 * phi[:, 3]
    return phi / np.sqrt(np.mean(phi**2, axis=0))


def test_the_corollary_on_the_rotor_gives_21_where_the_paper_prints_30() -> None:
    """(z_{0.975} + z_{1 - 0.05/12})^2 = (1.960 + 2.638)^2."""
    assert detection_margin(6, 0.05, 0.05) == pytest.approx(21.14, abs=0.01)
    assert samples_needed(0.15, 6, 0.05, 0.1) == pytest.approx(0.25 / 0.15 * 21.14 + 6, abs=0.05)


def test_needed_samples_and_ratio_go_with_one_over_mu() -> None:
    assert samples_needed(0.01, 6, 1, 1) - 6 == pytest.approx(
        10 * (samples_needed(0.1, 6, 1, 1) - 6)
    )
    assert snr_min(0.01, 6, 1000) == pytest.approx(np.sqrt(10) * snr_min(0.1, 6, 1000))
    assert snr_min(0.1, 6, 1000, 0.5) == pytest.approx(2 * snr_min(0.1, 6, 1000))
    assert samples_needed(0.0, 6, 1, 1) == snr_min(0.0, 6, 1000) == np.inf


def test_the_bias_stays_under_its_bound_and_can_reach_it() -> None:
    rng = np.random.default_rng(0)
    phi = _columns(rng)
    mu = richness(phi).mu
    left, _, _ = np.linalg.svd(phi, full_matrices=False)
    for eta in (*rng.normal(size=(50, 400)), np.sin(np.arange(400)), left[:, -1]):
        bias = np.linalg.lstsq(phi, eta, rcond=None)[0]
        assert np.linalg.norm(bias) <= bias_bound(mu, np.sqrt(np.mean(eta**2))) * (1 + 1e-9)
    worst = np.linalg.lstsq(phi, left[:, -1], rcond=None)[0]
    assert np.linalg.norm(worst) == pytest.approx(bias_bound(mu, np.sqrt(1 / 400)), rel=1e-6)


def test_the_spread_stays_under_its_bound() -> None:
    rng = np.random.default_rng(1)
    phi = _columns(rng)
    errors = np.linalg.lstsq(phi, 0.3 * rng.normal(size=(400, 2000)), rcond=None)[0]
    found = np.sqrt(np.mean(np.sum(errors**2, axis=0)))
    theory = 0.3 * np.sqrt(np.trace(np.linalg.inv(phi.T @ phi)))
    bound = spread_bound(richness(phi).mu, 4, 400, 0.3)
    assert found == pytest.approx(theory, rel=0.05)
    assert theory <= bound <= 2 * theory  # sqrt(p) apart at most


def test_two_coefficient_vectors_along_an_unseen_direction_give_one_motion() -> None:
    rng = np.random.default_rng(2)
    phi = rng.normal(size=(300, 5)) * [1, 1e-6, 1e9, 1, 1]
    phi[:, 4] = 3 * phi[:, 0] - phi[:, 1] * 1e6
    found = richness(phi)
    assert (found.rank, found.columns, found.condition) == (4, 5, np.inf)
    v = found.unseen[:, 0] / np.linalg.norm(phi, axis=0)
    assert np.abs(phi @ v).max() < 1e-12
    owners = ("a", "b", "c", "d", "e")
    assert alias_groups(found, owners) == (("a", "b", "e"),)


def test_separate_degeneracies_are_separate_groups() -> None:
    rng = np.random.default_rng(3)
    base = rng.normal(size=(300, 3))
    found = richness(np.column_stack([base, -2 * base[:, 0], 5 * base[:, 1]]))
    assert found.rank == 3
    assert sorted(alias_groups(found, "abcde")) == [("a", "d"), ("b", "e")]


def test_a_direction_that_noise_makes_is_not_counted() -> None:
    rng = np.random.default_rng(4)
    clean = rng.normal(size=(5000, 1))
    noisy = np.hstack([clean, clean]) + 0.05 * rng.normal(size=(5000, 2))
    again = noisy + 0.05 * rng.normal(size=(5000, 2))
    assert richness(noisy).rank == 2
    assert richness(noisy, again).rank == 1


def test_a_signature_is_the_force_of_one_unit_of_its_coefficient() -> None:
    system = PlanarRotor()
    (record,) = RotorCoastdown(duration=1.0).load(system)
    gyroscopic = registry().effect_from_label("gyroscopic")
    found = signatures(seed_model(system), (gyroscopic,), record.truth, record)
    speed, truth = record.inputs["speed"], record.truth
    x, y = found.only(("gyroscopic.coefficient",)).columns[:, :, 0]
    assert np.allclose(x, -speed * truth["y_rate"], rtol=1e-12)
    assert np.allclose(y, speed * truth["x_rate"], rtol=1e-12)
    assert found.keys[0] == "system.phase_origin"
    assert found.owners[0] == "unbalance"


def run_json(capsys, *words: str) -> tuple[int, dict]:
    code = main([*words, "tracking.enabled=false", "--json", "-"])
    return code, json.loads(capsys.readouterr().out)


def test_constant_speed_is_refused_a_sweep_is_not(capsys) -> None:
    """The paper's dichotomy, and the sweep that the refusal proposes is accepted."""
    words = ("identify", "experiment=rotor_coastdown", *STEADY, FEW, "record.settled=true")
    code, refused = run_json(capsys, *words)
    assert (code, refused["verdict"], refused["columns"]) == (3, "not_identifiable", 10)
    assert refused["rank"] <= 5
    assert refused["samples_needed"] is None
    assert {"linear_stiffness", "speed_stiffness", "gyroscopic"} <= set(refused["aliases"][0])
    assert "sweep: [21.6, 2.4]" in refused["error"]["try"]
    plan = refused["advice"].rpartition("record.inputs=")[2].strip("'.")
    swept = [*(w for w in words if not w.startswith("record.inputs")), f"record.inputs={plan}"]
    code, found = run_json(capsys, *swept, "record.settled=false")
    assert (code, found["verdict"]) == (0, "identifiable")
    assert (found["rank"], found["aliases"]) == (10, [])
    assert found["mu"] > 1e-3
    assert found["condition"] < 1e4
    assert found["samples_needed"] < found["samples"]


def test_constant_speed_with_a_transient_tells_the_seed_apart(capsys) -> None:
    words = ("identify", "experiment=rotor_coastdown", *STEADY, "candidates=[]")
    code, found = run_json(capsys, *words)
    assert (code, found["rank"], found["columns"]) == (0, 6, 6)


@pytest.mark.parametrize(
    ("speed", "exit_"), [("{constant: 12, unit: Hz}", 3), ("{sweep: [40, 0], unit: Hz}", 0)]
)
def test_of_a_measured_file_the_states_are_estimated(capsys, tmp_path, speed, exit_) -> None:
    """2 % noise makes every column different; what noise makes does not count."""
    file = str(tmp_path / "a.csv")
    settled = "record.settled=" + ("true" if exit_ else "false")
    made = ["experiment=rotor_coastdown", *STEADY, settled, f"record.inputs={{speed: {speed}}}"]
    assert main(["simulate", *made, "--out", file]) == 0
    capsys.readouterr()
    given = ("system=planar_rotor", "record=csv", f"record.path={file}", "holdout=0.02", FEW)
    code, found = run_json(capsys, "identify", *given, "derivative=kalman_smoother")
    assert (code, found["planned"]) == (exit_, False)
    assert (found["rank"] == 10) == (exit_ == 0)
    if exit_:
        assert any({"linear_stiffness", "speed_stiffness"} <= set(g) for g in found["aliases"])


def test_hidden_states_in_the_equations_are_refused(capsys, tmp_path) -> None:
    file = str(tmp_path / "a.csv")
    assert main(["simulate", "experiment=rotor_coastdown", "record.duration=2", "--out", file]) == 0
    capsys.readouterr()
    given = ("system=tilting_rotor", "record=csv", f"record.path={file}")
    code, found = run_json(capsys, "identify", *given, "derivative=kalman_smoother")
    assert code == 2
    assert "planar_rotor" in found["error"]["try"]

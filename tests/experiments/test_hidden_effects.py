"""Every mechanical and rotor effect, hidden in the truth and left out of the model."""

from dataclasses import replace

import pytest
import sympy as sp
from spiral_plugins.systems.cascaded_tanks import CascadedTanks

from experiments.hidden_effects.benchmark import Job, main, study
from experiments.hidden_effects.cases import CASES
from experiments.hidden_effects.cases import installed as registry_of_chains
from experiments.hidden_effects.run import outcome
from experiments.hidden_effects.strengths import SHARES, Hidden, strengths
from experiments.studies.rates import wilson
from spiral.io.problem_setup import USUAL_STRATEGY
from spiral.physics.trace import trace
from spiral.types.effect import ForceEffect
from tests.marks import others_slow
from tests.scenes import registry

SOME = (
    "linear_stiffness", "quadratic_stiffness", "stop", "cross_stiffness", "rub", "coulomb_friction",
    "antisymmetric_damping", "shaft_bow", "gravity_torque", "asymmetric_stiffness",
)  # fmt: skip
"""Of every family some, none with states of its own, whose studies are longer."""
QUICK = [c for c in CASES if c.effect in SOME]


# The first of them, linear_stiffness, takes longest.
@pytest.mark.parametrize("case", others_slow(QUICK[::-1], 3), ids=lambda c: c.effect)
def test_of_a_short_record_the_hidden_effect_is_the_first_suggestion_and_adding_it_is_enough(case):
    found_and_enough(replace(case, scene=replace(case.scene, duration=0.2 * case.scene.duration)))


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda c: c.effect)
def test_the_hidden_effect_is_the_first_suggestion_and_adding_it_is_enough(case):
    """By the default strategy: windows alone (``shooting``) miss some with states of their own."""
    found_and_enough(case, USUAL_STRATEGY)


def found_and_enough(case, strategy="shooting"):
    found = outcome(case, seed=1, noise=0.02, strategy=strategy)
    assert found["hit"]
    assert found["before"] > 1.5
    assert found["after"] <= 1.2


def test_a_gap_that_windows_found_stays_where_they_found_it():
    """Refitted from states read off noisy samples it grew beyond the motion: rub took its place."""
    values = {"stiffness": 1283.0, "gap": 1.1596e-4, "width": 3.865e-6}
    gap = Hidden("planar_rotor", "clearance", "medium", values, 0.2, 15800.0)
    row = study(Job(gap, 0.02, 1, "shooting"))
    assert row is not None
    assert row["admitted"] == ["clearance"]


def test_every_shipped_force_effect_with_a_name_has_a_case():
    names = {c.effect for c in CASES}
    effects = [e for e in registry().entries if e.kind == "effect" and not e.plugin.bare]
    assert {e.name for e in effects if issubclass(e.plugin, ForceEffect)} == names


def test_wilsons_interval_is_the_published_one():
    """Newcombe 1998, table I: 15 of 148 gives 0.0624 to 0.1605; 0 of 20 gives 0 to 0.1611."""
    assert wilson(15, 148) == pytest.approx((0.0624, 0.1605), abs=5e-5)
    assert wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=5e-5)


def test_an_amplitude_gives_the_share_it_was_found_for():
    for hidden in strengths("oscillator", "cubic_stiffness", registry()):
        assert hidden.share == pytest.approx(SHARES[hidden.strength], rel=0.03)
    gain = strengths("oscillator", "gain", registry())
    assert not any(h.identifiable(0.005) for h in gain)


@pytest.mark.slow
def test_the_benchmark_in_its_fast_mode(tmp_path, capsys):
    """Three effects at medium strength, one seed each, and as many null records; taken up again."""
    words = ["--systems", "oscillator", "--only", "cubic_stiffness", "offset", "gain",
             "--strengths", "medium", "--noises", "0.02", "--seeds", "1", "--jobs", "1",
             "--no-tracking", "--out", str(tmp_path)]  # fmt: skip
    found = main(words)
    known, null = found["medium_2_percent"], found["null"]["false"]
    assert (known["first"]["hits"], known["first"]["count"]) == (2, 2)
    assert (null["hits"], null["count"]) == (0, 3)
    assert known["over_floor"] < 1.2
    assert found["not_identifiable"]["named_or_nothing"]["rate"] == 1.0
    assert "oscillator" in (tmp_path / "oscillator.html").read_text()[-4000:]
    again = main(words)
    assert again["studies"] == len((tmp_path / "rows.jsonl").read_text().splitlines()) == 6


@pytest.mark.slow
def test_twins_are_aliases_whatever_their_fits_left_to_converge():
    """An offset of the sensors and a constant load give one motion in a linear machine."""
    hidden = next(h for h in strengths("planar_rotor", "offset", registry()) if h.share > 0.1)
    found = study(Job(hidden, 0.02, 1))
    assert {*found["admitted"], *found["aliases"]} == {"offset", "constant_load"}


def test_sensors_and_flows_with_cases_are_traced_together():
    """A saturation of what is late by flows with rims: cases must not nest without end."""
    names = ("delay", "sensor_lag", "overflow", "sensor_saturation")
    system = CascadedTanks()
    effects = (*(registry().effect_from_label(n) for n in names), *system.seed)
    (reading,) = trace(system, effects).output
    assert sp.count_ops(reading) < 1000


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "label", "strength", "noise", "seed", "floors"), [
    # begins slowly, beside noise of the seed's; the head of a test record tells less of its phase
    # where what the late sensors hold is unknown too
    ("planar_rotor", "delay", "strong", 0.005, 2, 1.4),
    # several valleys, a shape tried at zero
    ("chain_2", "bouc_wen@link1", "medium", 0.02, 1, 1.2),
    # of both sensors: a load in one number
    ("chain_2", "offset", "medium", 0.02, 1, 1.2),
])  # fmt: skip
def test_the_default_names_what_is_hidden_first_and_alone(
    scene, label, strength, noise, seed, floors
):
    made = strengths(scene, label, registry_of_chains())
    (hidden,) = (h for h in made if h.strength == strength)
    found = study(Job(hidden, noise, seed))
    assert found["first"]
    assert not found["invented"]
    assert found["after"] < floors * found["floor"]

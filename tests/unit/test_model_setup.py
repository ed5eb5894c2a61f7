"""The model set up on the page: its parameters, and what the command line is told of a choice."""

from spiral.app.file_preview import describe_model
from spiral.app.record_setup import Choice, RecordSetup, setup_overrides
from spiral.io.config import build_model, compose
from tests.scenes import registry

SERIES = {"unit": "m", "required": True}


def model(*given):
    known = registry()
    return build_model(compose(given, known), known)


def test_every_parameter_has_a_unit_a_value_and_a_state():
    found = describe_model(model("system=tilting_rotor"), registry())
    rows = {r["key"]: r for r in found["parameters"]}
    mass, spring = rows["system.mass"], rows["linear_stiffness@bearing_1.stiffness_x"]
    assert (mass["unit"], mass["lower"], mass["value"], mass["free"]) == ("kg", 0.0, 1.15, False)
    assert (spring["unit"], spring["free"]) == ("N/m", True)
    assert "system.phase_origin" not in rows  # of a record, not of the machine
    assert len(found["seed"]) == 11
    assert all(e["meaning"] for e in found["seed"])


def test_a_choice_is_the_same_model_as_from_the_command_line():
    choice = Choice(
        "oscillator", "", "500", {"x": "a"}, without=("linear_damping",),
        values={"system.mass": "2.0", "linear_stiffness.stiffness": " "},
        free={"system.mass": False, "linear_stiffness.stiffness": True},
    )  # fmt: skip
    system = {"name": "oscillator", "channels": [{"name": "x", **SERIES}], "inputs": []}
    setup = RecordSetup("20260101-000000-abc", "a.csv", "a.csv", systems=(system,), choice=choice)
    given = [o for o in setup_overrides(setup) if not o.startswith("record")]
    found = model(*given)
    assert found.labels == ("linear_stiffness",)
    assert found.values["system.mass"] == 2.0
    assert set(found.active) == {"linear_stiffness.stiffness"}


def test_effects_at_ports_of_ones_own_choice_are_in_the_model():
    found = describe_model(model("system=tilting_rotor"), registry())
    friction = next(e for e in found["addable"] if e["name"] == "coulomb_friction")
    assert friction["ports"]["coulomb_friction@bearing_2"] == "bearing_2"
    choice = Choice("tilting_rotor", "", "500", {"x": "a", "y": "b", "speed": "n"},
                    effects=("coulomb_friction@bearing_2",))  # fmt: skip
    system = {"name": "tilting_rotor", "channels": [{"name": "x", **SERIES}], "inputs": []}
    setup = RecordSetup("20260101-000000-abc", "a.csv", "a.csv", systems=(system,), choice=choice)
    given = [o for o in setup_overrides(setup) if not o.startswith("record")]
    assert "coulomb_friction@bearing_2" in model(*given).labels

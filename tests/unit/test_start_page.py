"""What the first page offers: presets that run here, and by name those that lack their data."""

from spiral.app.start import presets
from spiral.io.config import experiments
from spiral.view.report.style import label_title, label_words


def by_name():
    return {p.name: p for p in presets()}


def test_presets_on_measured_data_are_offered_only_where_it_is(monkeypatch, tmp_path):
    monkeypatch.setenv("SPIRAL_DATA", str(tmp_path))
    lacking = {n for n, p in by_name().items() if p.lacks}
    assert {"silverbox", "cascaded_tanks", "multiarm_pendulum"} <= lacking
    assert "rotor_coastdown" not in lacking
    (tmp_path / "silverbox").mkdir()
    (tmp_path / by_name()["silverbox"].lacks).write_text("")
    assert by_name()["silverbox"].lacks is None


def test_every_preset_has_a_sentence_and_the_demo_is_first():
    found = presets()
    assert found[0].name == "rotor_coastdown"
    assert {p.name for p in found} <= set(experiments())
    assert all(len(p.said) > 20 for p in found)


def test_names_of_people_and_makes_are_written_as_they_are():
    assert label_title("rk4_rotor_runup") == "RK4 rotor runup"
    assert label_title("rotor_coastdown") == "Rotor coastdown"
    assert label_words("bouc_wen@bearing_2") == "Bouc-Wen at bearing 2"
    assert label_words("coulomb_friction") == "Coulomb friction"
    assert label_words("bricks4") == "bricks4"  # no part of a word

"""Texts of the page as HTML: indices, numbers that are not broken, values that a file lacks."""

import json

import numpy as np

from spiral.app.data_setup import missing_values_note
from spiral.app.file_preview import PICTURE, describe_file
from spiral.app.panels import effect_meaning, headline
from spiral.app.study import StudyState, add_turn, new_study


def test_indices_of_a_meaning_stand_below():
    said = effect_meaning("A second spring: F_i = -k_x (|q_i|^2 - g)_+ + F_c,i for x_1' < 0.")
    for letter in ("F<sub>i</sub>", "k<sub>x</sub>", "|q<sub>i</sub>|²", "F<sub>c,i</sub>",
                   "x<sub>1</sub>&#x27; &lt; 0"):  # fmt: skip
        assert letter in said
    assert "_" not in said


def test_the_number_of_a_very_small_error_is_one_word(tmp_path):
    study = new_study(tmp_path, "small", ())
    study = add_turn(study, StudyState(0, "", {"test_error": 1e-7}))
    assert '<span class="one-line">&lt; 0.001 %</span>' in headline(study)


def test_rows_without_a_value_are_marked_in_the_picture(tmp_path):
    rows = [f"{i / 100},{'' if i in (7, 8) else np.sin(i)}" for i in range(50)]
    (tmp_path / "gap.csv").write_text("t,x\n" + "\n".join(rows) + "\n")
    told = {}
    order = {"path": str(tmp_path / "gap.csv"), "folder": str(tmp_path)}
    describe_file(order, lambda kind, data: told.update({kind: data}))
    columns = told["columns"]["columns"]
    assert [c["missing"] for c in columns] == [0, 2]
    assert missing_values_note(columns).endswith("2 in x.")
    assert missing_values_note(columns[:1]) == ""
    drawn = json.loads((tmp_path / PICTURE).read_text())["data"]
    marks = [t for t in drawn if t["mode"] == "markers"]
    assert [t["name"] for t in marks] == ["no value"]
    assert marks[0]["yaxis"] == drawn[1]["yaxis"]

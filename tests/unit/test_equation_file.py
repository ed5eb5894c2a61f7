"""A system's equations in a file: what is said where there is no such file."""

import pytest

from spiral.physics.formulas.definition import text_of_file
from spiral.types.errors import InputError


def test_a_file_that_is_not_there_is_answered_with_names_near_it(tmp_path):
    (tmp_path / "furnace.yaml").write_text("equations: []", encoding="utf-8")
    with pytest.raises(InputError) as near:
        text_of_file(tmp_path / "furnac.yaml")
    assert near.value.try_ == f"did you mean {tmp_path / 'furnace.yaml'}?"
    with pytest.raises(InputError) as far:
        text_of_file(tmp_path / "nowhere" / "x.yaml")
    assert far.value.try_ == "check the path"

"""One place takes the labels of effects apart, and puts them together."""

import re
from pathlib import Path

import pytest

import spiral
from spiral.types.label import make_label, name_of, split_port, split_variant


@pytest.mark.parametrize("port", ["", "bearing_2", "upper-lower"])
@pytest.mark.parametrize("variant", ["", "3"])
def test_what_is_put_together_comes_apart(port, variant):
    label = make_label("cubic_stiffness", port, variant)
    plain, tag = split_variant(label)
    assert (*split_port(plain), tag) == ("cubic_stiffness", port, variant)
    assert name_of(label) == "cubic_stiffness"
    assert make_label("cubic_stiffness", port) == plain


def test_nobody_else_takes_one_apart():
    apart = re.compile(r"(split|partition)\(\s*['\"][@#]['\"]")
    package = Path(spiral.__file__).parent
    found = {p.name for p in package.rglob("*.py") if apart.search(p.read_text())}
    assert found == {"label.py"}

"""One place takes the labels of effects apart, and puts them together."""

import re
from pathlib import Path

import pytest

import spiral
from spiral.types.label import (
    make_label,
    name_of,
    owner_of,
    parameter_of,
    split_key,
    split_port,
    split_variant,
    without_variant,
)


@pytest.mark.parametrize("port", ["", "bearing_2", "upper-lower"])
@pytest.mark.parametrize("variant", ["", "3"])
def test_what_is_put_together_comes_apart(port, variant):
    label = make_label("cubic_stiffness", port, variant)
    plain, tag = split_variant(label)
    assert (*split_port(plain), tag) == ("cubic_stiffness", port, variant)
    assert name_of(label) == "cubic_stiffness"
    assert make_label("cubic_stiffness", port) == plain


@pytest.mark.parametrize("owner", ["system", "gap@nut-table", "bouc_wen@joint#0.5"])
def test_a_key_is_its_owner_and_a_parameter(owner):
    assert split_key(f"{owner}.stiffness") == (owner, "stiffness")
    assert (owner_of(f"{owner}.stiffness"), parameter_of(f"{owner}.stiffness")) == (
        owner, "stiffness",
    )  # fmt: skip


def test_a_text_without_a_dot_is_an_owner():
    assert split_key("cubic_stiffness") == ("cubic_stiffness", "")


def test_nobody_else_takes_one_apart():
    apart = re.compile(r"(split|partition)\(\s*['\"][@#]['\"]")
    package = Path(spiral.__file__).parent
    found = {p.name for p in package.rglob("*.py") if apart.search(p.read_text())}
    assert found == {"label.py"}


def test_users_see_no_variant():
    assert without_variant("overflow#6.rim") == "overflow.rim"
    assert without_variant("clearance@shaft#3.gap") == "clearance@shaft.gap"
    assert without_variant("cubic_stiffness@bearing") == "cubic_stiffness@bearing"

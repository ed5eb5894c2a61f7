"""Overrides, which a study's file holds as well: nothing run, read from outside, or without end."""

import time

import pytest

from spiral.io.config import compose
from spiral.io.overrides import parse_overrides
from spiral.io.readers.formats import read_table
from spiral.io.registry import load_registry
from spiral.types.errors import SpiralError

REGISTRY = load_registry(local=False)
FILE = "file:"  # an address of the disk


@pytest.mark.parametrize(
    ("given", "value"),
    [
        ("record.units={T: degC, X: g/m^3}", {"T": "degC", "X": "g/m^3"}),
        ("record.channels={x: t [s], y: b^2}", {"x": "t [s]", "y": "b^2"}),
        ("a={b: {c: g/m^3}, d: 2.5e-3, e: [1,2]}", {"b": {"c": "g/m^3"}, "d": 2.5e-3, "e": [1, 2]}),
        ("record.time=t [s]", "t [s]"),
        (
            "record.channels={x'': acc, x: laser, y': rate}",
            {"x_acceleration": "acc", "x": "laser", "y_rate": "rate"},
        ),
    ],
)
def test_values_that_the_grammar_does_not_read_are_text_also_in_a_mapping(given, value):
    assert parse_overrides((given,))[0].value == value


@pytest.mark.hostile("overrides")
@pytest.mark.parametrize(
    "given",
    [
        "+x=!!python/object/apply:os.system [touch ran]",
        "settings.max_rounds=" + "9" * 5000,
        "x=" + "[" * 3000 + "]" * 3000,
        "x=" + "{a: " * 500 + "1" + "}" * 500,
        "x=" + "1," * 200_000,
        "record.duration=range(0,1000000000)",
        "record.duration=glob(*)",
        "x=\x00",
        "x=${oc.env:HOME",
    ],
    ids=lambda text: text[:24],
)
def test_what_is_no_override_is_refused_at_once(given):
    began = time.monotonic()
    with pytest.raises(SpiralError) as caught:
        parse_overrides((given,))
    assert len(str(caught.value)) < 2000
    assert time.monotonic() - began < 10


@pytest.mark.hostile("overrides")
@pytest.mark.parametrize(
    "given",
    [
        "+_target_=os.system",
        "record._target_=os.system",
        "record=../../../etc/passwd",
        "system=os",
        "experiment=../../secret",
        f"hydra.searchpath=[{FILE}///tmp]",
        "hydra.run.dir=/tmp/elsewhere",
        "hydra.job.env_set={PATH: /tmp}",
    ],
)
def test_what_is_no_choice_is_refused(given):
    with pytest.raises(SpiralError):
        compose((given,), REGISTRY)


@pytest.mark.hostile("overrides")
def test_nothing_is_put_into_a_text(monkeypatch):
    """Of the environment, for instance, where a downloaded study asks for it."""
    monkeypatch.setenv("SECRET", "hush")
    texts = ["${oc.env:SECRET}", "${oc.decode:${oc.env:SECRET}}", "${hydra:runtime.cwd}",
             "${system}"]  # fmt: skip
    listed = ", ".join(f"'{text}'" for text in texts)
    given = ("system=oscillator", "record=csv", f"record.path=[{listed}]")
    assert compose(given, REGISTRY)["record"]["path"] == texts


@pytest.mark.hostile("overrides")
@pytest.mark.parametrize(
    "path",
    [
        "/dev/zero",
        "/dev/stdin",
        "/",
        "http://127.0.0.1:9/a.csv",
        f"{FILE}///etc/passwd",
        "s3://bucket/a.csv",
        "\x00",
        "a" * 5000,
    ],
    ids=lambda text: repr(text)[:20],
)
def test_what_is_no_file_is_not_read(path):
    """A device has no end, and pandas would fetch an address."""
    with pytest.raises(SpiralError) as caught:
        read_table(path)
    assert len(str(caught.value)) < 2000

"""Names for parts of equations are the formulas that they stand for."""

import pytest
import sympy
import yaml

import spiral
from spiral.physics.formulas.equations import equations_of

SECTIONS = yaml.safe_load("""
equations: ["L*i' = V - e", "m*x'' + c*x' + k*x = f"]
let: {e: R*i + b*x', f: b*i + loss, loss: d*x'*abs(x')}
states: {x: m, i: A}
inputs: {V: V}
parameters: {L: 1 H, R: 2 ohm, b: 3 N/A, m: 1 kg, c: 1 N*s/m, k: 9 N/m, d: 2 N*s^2/m^2}
observed: [i, f, "left = V - e"]
""")
WRITTEN_OUT = SECTIONS | {
    "equations": ["L*i' = V - R*i - b*x'", "m*x'' + c*x' + k*x = b*i + d*x'*abs(x')"],
    "observed": ["i", "f = b*i + d*x'*abs(x')", "left = V - R*i - b*x'"],
}
del WRITTEN_OUT["let"]


def test_a_name_is_its_formula():
    named, plain = (equations_of(yaml.safe_dump(s)) for s in (SECTIONS, WRITTEN_OUT))
    assert (named.mass, named.force, named.flow) == (plain.mass, plain.force, plain.flow)
    for (one, text), (other, written) in zip(named.readings, plain.readings, strict=True):
        assert (one, sympy.expand(text)) == (other, sympy.expand(written))


def test_from_python_too():
    sections = {k: v for k, v in SECTIONS.items() if k != "equations"}
    system = spiral.system(SECTIONS["equations"], **sections)
    assert [r.name for r in system.readings] == ["f", "left"]


@pytest.mark.parametrize(
    ("let", "said"),
    [
        ({"e": "2*f", "f": "e + V"}, "circle"),
        ({"e": "R*i", "f": "e'"}, "rate of what let names"),
        ({"e": "R*i", "f": "b*i", "x": "i"}, "another meaning"),
        ({"e": "R*i", "f": "b*i", "t": "i"}, "another meaning"),
        ({"e": "R*i", "f": "b*i", "2x": "i"}, "no name"),
        (["e"], "names and their formulas"),
    ],
)
def test_what_cannot_be_written_out_is_refused(let, said):
    with pytest.raises(spiral.SpiralError, match=said):
        spiral.system(SECTIONS | {"let": let})

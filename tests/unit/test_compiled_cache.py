"""The cache of compiled models: known models are not generated again, damaged files are."""

import numpy as np
import pytest
from spiral_plugins.systems.oscillator import Oscillator
from spiral_plugins.systems.planar_rotor import PlanarRotor

from spiral.physics import compile as compiler
from spiral.physics.compile import compile_model
from spiral.physics.trace import trace
from tests.scenes import effect


@pytest.fixture
def generated(tmp_path, monkeypatch):
    """How often code was generated, in a cache folder of its own."""
    count = []
    original = compiler.generate
    monkeypatch.setenv("SPIRAL_CACHE", str(tmp_path))
    monkeypatch.setattr(compiler, "generate", lambda *given: count.append(1) or original(*given))
    forget(monkeypatch)
    return count


def forget(monkeypatch):
    """As if another process had started."""
    import sys

    for name in [n for n in sys.modules if n.startswith("spiral_model_")]:
        monkeypatch.delitem(sys.modules, name)


def model(*labels, system=None):
    system = system or Oscillator()
    return trace(system, (*system.seed, *(effect(x) for x in labels)))


def test_a_known_model_is_not_generated_again(generated, monkeypatch):
    compile_model(model())
    forget(monkeypatch)
    compile_model(model())
    assert len(generated) == 1
    compile_model(model("cubic_stiffness"))
    assert len(generated) == 2


def test_a_damaged_file_is_written_anew(generated, tmp_path, monkeypatch):
    compile_model(model("cubic_stiffness"))
    (file,) = tmp_path.rglob("spiral_model_*.py")
    whole = file.read_text()
    file.write_text(whole[: len(whole) // 2])
    forget(monkeypatch)
    compile_model(model("cubic_stiffness"))
    assert file.read_text() == whole
    assert len(generated) == 2


def test_the_name_follows_the_equations_and_the_derivatives():
    def name(label, by=None):
        return compiler._digest(model(label), by)

    assert name("coulomb_friction") != name("clearance")
    assert name("coulomb_friction") == name("coulomb_friction")
    assert name("coulomb_friction") != name("coulomb_friction", ("system.mass",))


def test_a_shape_of_zero_gives_no_number_rather_than_an_exception():
    """tanh(v / w) at w = 0, where a freed width may come to stand: its slope is not finite."""
    compiled = compile_model(model("coulomb_friction", system=PlanarRotor()))
    p = np.array([0.0 if key.endswith(".width") else 1.0 for key in compiled.traced.keys])
    f, by_x, by_p = np.zeros(4), np.zeros((4, 4)), np.zeros((4, len(p)))
    compiled.rate(np.full(4, 0.1), np.zeros(len(compiled.traced.u)), p, f, by_x, by_p)
    assert np.isfinite(f).all()  # the friction itself stays at its level
    assert not np.isfinite(by_p).all()

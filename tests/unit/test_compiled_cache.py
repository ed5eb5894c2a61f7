"""The cache of compiled models: known models are not generated again, damaged files are."""

import pytest
from spiral_plugins.systems.oscillator import Oscillator

from spiral import compile as compiler
from spiral.compile import compile_model
from spiral.trace import trace
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


def model(*labels):
    system = Oscillator()
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

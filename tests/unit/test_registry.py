"""Plugins: found, named, refused with near misses, failures reported."""

import subprocess
import sys
import textwrap

import pytest

from spiral.io.registry import load_registry
from spiral.types.errors import ConfigError, PluginError

EFFECT = '''
from spiral.types.effect import ForceEffect
from spiral.types.parameter import Parameter


class {name}(ForceEffect):
    """A spring of one's own: F = -k q."""

    parameters = (Parameter("stiffness", "force/position"),)
    strength: int = 1

    def force(self, at, u, p):
        return [-p.stiffness * q for q in at.position]
'''


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    place = tmp_path / "plugins"
    place.mkdir()
    return place


def test_shipped_plugins_are_found_everywhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    registry = load_registry()
    assert {"effect", "source", "system"} <= set(registry.kinds)
    assert {"oscillator", "planar_rotor", "tilting_rotor"} <= set(registry.names("system"))
    assert {"csv", "simulation", "rotor_coastdown"} <= set(registry.names("source"))
    assert registry.failures == ()


def test_finding_plugins_imports_no_numerics():
    code = (
        "import sys; from spiral.io.registry import load_registry\n"
        "load_registry()\n"
        "heavy = {'scipy','sympy','numba','torch','sklearn','statsmodels','pandas','mlflow'}\n"
        "sys.exit(', '.join(heavy & set(sys.modules)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_shipped_folder_is_not_read_twice(monkeypatch):
    import spiral_plugins

    again = load_registry(spiral_plugins.__path__[0])
    assert [e.name for e in again.entries] == [e.name for e in load_registry().entries]
    assert all(e.origin != "local" for e in again.entries)


@pytest.mark.parametrize("how", ["default", "argument", "variable"])
def test_a_file_in_a_folder_is_a_plugin(folder, monkeypatch, how):
    place = folder if how == "default" else folder.rename(folder.parent / "mine")
    (place / "own.py").write_text(EFFECT.format(name="OwnSpring"))
    if how == "variable":
        monkeypatch.setenv("SPIRAL_PLUGINS", str(place))
    registry = load_registry(place if how == "argument" else None)
    effect = registry.effect_from_label("own_spring@disk", {"strength": 3})
    assert (effect.label, effect.strength) == ("own_spring@disk", 3)
    entry = registry.entry("effect", "own_spring")
    assert (entry.origin, entry.file) == ("local", str(entry.file))
    assert "own_spring" in [
        e.label for e in registry.candidates(registry.make("system", "planar_rotor"))
    ]


def test_a_named_folder_must_be_there(tmp_path):
    with pytest.raises(ConfigError, match="plugin folder"):
        load_registry(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("import nonsense_package", "nonsense_package"),
        ("def broken(:", "SyntaxError"),
        ("raise SystemExit(3)", "SystemExit"),
        ("1 / 0", "broken.py, line 1"),
    ],
)
def test_a_broken_file_is_reported_and_hides_nobody(folder, text, word):
    (folder / "broken.py").write_text(text)
    (folder / "own.py").write_text(EFFECT.format(name="OwnSpring"))
    registry = load_registry()
    assert "own_spring" in registry.names("effect")
    (failure,) = registry.failures
    assert failure.name == "broken"
    assert failure.file.endswith("broken.py")
    assert word in failure.message
    with pytest.raises(ConfigError, match=r"broken\.py"):
        registry.effect_from_label("broken")


def test_a_forgotten_method_is_reported(folder):
    (folder / "own.py").write_text(EFFECT.format(name="OwnSpring").replace("def force", "def frce"))
    (failure,) = load_registry().failures
    assert failure.name == "own_spring"
    assert "force" in failure.message


def test_one_name_twice_is_refused_with_both_places(folder):
    (folder / "one.py").write_text(EFFECT.format(name="OwnSpring"))
    (folder / "two.py").write_text(EFFECT.format(name="OwnSpring"))
    with pytest.raises(PluginError) as caught:
        load_registry()
    assert "one.py" in caught.value.given
    assert "two.py" in caught.value.given


def test_a_shipped_name_cannot_be_taken(folder):
    (folder / "own.py").write_text(EFFECT.format(name="CubicStiffness"))
    with pytest.raises(PluginError, match="cubic_stiffness"):
        load_registry()


@pytest.mark.parametrize("word", ["cubic_stifness", "cubic", "Cubic_Stiffness"])
def test_unknown_names_get_near_misses(word):
    with pytest.raises(ConfigError) as caught:
        load_registry().effect_from_label(word)
    assert "'cubic_stiffness'" in caught.value.try_


def test_unknown_fields_get_near_misses():
    with pytest.raises(ConfigError) as caught:
        load_registry().make("system", "oscillator", {"position_unti": "V"}, "system")
    assert caught.value.given == "system.position_unti"
    assert "'position_unit'" in caught.value.try_


def test_fields_are_typed():
    registry = load_registry()
    with pytest.raises(ConfigError, match="a whole number"):
        registry.make("source", "rotor_coastdown", {"seed": 1.5}, "record")
    with pytest.raises(ConfigError, match="true or false"):
        registry.make("source", "rotor_coastdown", {"settled": 1}, "record")
    assert registry.make("source", "rotor_coastdown", {"seed": 2.0}).seed == 2


def test_candidates_fit_axes_inputs_and_units():
    registry = load_registry()
    rotor = [e.label for e in registry.candidates(registry.make("system", "planar_rotor"))]
    single = [e.label for e in registry.candidates(registry.make("system", "oscillator"))]
    assert {"gyroscopic", "cubic_stiffness", "crack"} <= set(rotor)
    assert "gravity_torque" not in rotor  # one axis only
    assert not {"gyroscopic", "cross_stiffness", "crack", "unbalance"} & set(single)
    assert "gravity_torque" not in single  # the sine of a length


def test_plugins_inside_fields_are_found_by_name():
    registry = load_registry()
    source = registry.make(
        "source",
        "simulation",
        {
            "system": {"name": "oscillator", "position_unit": "V"},
            "effects": ["cubic_stiffness", {"name": "clearance", "port": "mass"}],
        },
    )
    assert source.system.position_unit == "V"
    assert [e.label for e in source.effects] == ["cubic_stiffness", "clearance@mass"]


def test_helper_modules_may_hold_several_plugins(folder):
    inner = folder / "inner"
    inner.mkdir()
    text = EFFECT.format(name="OwnSpring") + textwrap.dedent(
        '''
        class OtherSpring(ForceEffect):
            """Another."""

            def force(self, at, u, p):
                return [0 * q for q in at.position]
        '''
    )
    (inner / "several.py").write_text(text)
    (folder / "_private.py").write_text("raise ValueError")
    registry = load_registry()
    assert {"own_spring", "other_spring"} <= set(registry.names("effect"))
    assert registry.failures == ()

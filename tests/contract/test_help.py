"""Help of a verb lists the plugins of each group; nothing that is broken breaks it."""

import time
from dataclasses import fields

import pytest

from spiral.cli import main
from spiral.inference.problem import Settings
from spiral.io.registry import load_registry

OWN = '''
from spiral.types.effect import ForceEffect
from spiral.types.parameter import Parameter


class MySpring(ForceEffect):
    """A spring of my own."""

    steps: int = 3
    parameters = (Parameter("stiffness", "force/position"),)

    def force(self, at, u, p):
        return [-p.stiffness * q for q in at.position]
'''


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    (tmp_path / "plugins").mkdir()
    (tmp_path / "plugins" / "mine.py").write_text(OWN)
    (tmp_path / "plugins" / "broken.py").write_text("1 / 0")


def told(capsys, *words):
    code = main(list(words))
    return code, capsys.readouterr().out


@pytest.mark.parametrize("verb", ["discover", "compare", "diagnose", "add", "simulate"])
def test_every_plugin_is_in_the_help_of_its_group(capsys, verb):
    code, out = told(capsys, verb, "--help")
    assert code == 0
    names = out.replace("\n", " ").split()
    for entry in load_registry().entries:
        assert entry.name in {name.rstrip(",") for name in names}
    for group in ("system=", "record=", "test=", "effect=", "experiment=", "-h, --help"):
        assert group in out
    assert "my_spring" in out
    assert "broken" in out
    assert "ZeroDivisionError" in out
    assert max(map(len, out.split("options of each group")[1].split("first steps")[0].splitlines())) <= 80  # fmt: skip  # noqa: E501


def test_help_of_a_group_and_of_a_plugin(capsys):
    _, out = told(capsys, "discover", "--help", "effect")
    assert "A spring of my own. [local" in out
    assert "fields: port, steps" in out
    assert "oscillator" not in out
    _, out = told(capsys, "discover", "--help", "effect=my_spring")
    assert "effect.my_spring.steps=3" in out
    assert "stiffness (force/position)" in out
    _, out = told(capsys, "compare", "--help", "csv")
    assert "record.path=null" in out
    assert main(["discover", "--help", "sytem"]) == 2
    assert "did you mean 'system'" in capsys.readouterr().err


def test_help_of_the_settings(capsys):
    """Each with its usual value and its meaning, from the docstring of their class."""
    code, out = told(capsys, "discover", "--help", "settings")
    assert code == 0
    for item in fields(Settings):
        assert f"settings.{item.name}=" in out
    assert "settings.learned=false\n        whether discover admits a learned curve" in out
    assert main(["discover", "--help", "setings"]) == 2
    assert "did you mean 'settings'" in capsys.readouterr().err


def test_help_of_any_other_key_is_what_the_configuration_says_of_it(capsys):
    _, out = told(capsys, "discover", "--help")
    assert "tracking, curves" in out.replace("\n              ", " ")
    code, out = told(capsys, "discover", "--help", "tracking", "out")
    assert code == 0
    assert "log every run to MLflow" in out
    assert "folder of saved runs" in out
    code, out = told(capsys, "compare", "--help", "others")
    assert code == 0
    assert "parameters that no fit moves" in out
    assert "log every run to MLflow" in out


def test_help_without_plugins_that_load(capsys):
    code, out = told(capsys, "discover", "--help", "--plugins", "nowhere")
    assert code == 0
    assert "nowhere" in out
    assert "first steps" in out


def test_help_of_a_verb_is_quick(capsys):
    told(capsys, "discover", "--help")
    clock = time.perf_counter()
    told(capsys, "discover", "--help")
    assert time.perf_counter() - clock < 2.0

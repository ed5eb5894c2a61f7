"""Files of ``./plugins`` are run, as the folder's owner wants; never without a word."""

import json
from unittest.mock import Mock

import pytest

from spiral.app import session as sessions
from spiral.cli import main
from spiral.io.registry import NO_FOLDER, load_registry, local_sources


@pytest.fixture
def folder(tmp_path, monkeypatch, plugin):
    """A current folder with two local plugins, one of them broken."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SPIRAL_PLUGINS", raising=False)
    (tmp_path / "plugins").mkdir()
    (tmp_path / "plugins" / "own.py").write_text(plugin)
    (tmp_path / "plugins" / "broken.py").write_text("1 / 0")
    return tmp_path / "plugins"


def test_every_file_that_was_run_is_named_once_on_standard_error(folder, capsys, trace):
    """Also those that failed: they were run up to where they did."""
    assert main(["plugins", "--json", "-"]) == 0
    said = capsys.readouterr()
    names = {e["name"] for e in json.loads(said.out)["plugins"]}  # standard output is JSON alone
    assert "own_spring" in names
    assert trace.exists()
    assert said.err.count("plugins/own.py") == 1
    assert said.err.count("plugins/broken.py") == 1
    assert "--no-plugins" in said.err


@pytest.mark.parametrize("variable", [False, True])
def test_without_plugins_no_file_is_run_or_named(folder, capsys, trace, monkeypatch, variable):
    if variable:
        monkeypatch.setenv("SPIRAL_PLUGINS", str(folder))
    assert main(["plugins", "effect", "--no-plugins", "--json", "-"]) == 0
    said = capsys.readouterr()
    assert not trace.exists()
    assert "own.py" not in said.err
    assert "own_spring" not in said.out


def test_help_names_what_it_runs_and_can_do_without(folder, capsys, trace):
    assert main(["compare", "--help", "effect", "--no-plugins"]) == 0
    assert not trace.exists()
    assert main(["compare", "--help", "effect"]) == 0
    assert "plugins/own.py" in capsys.readouterr().err


def test_shipped_plugins_are_not_named(tmp_path, monkeypatch, capsys):
    """Neither without a folder, nor where the folder is the shipped one."""
    import spiral_plugins

    monkeypatch.chdir(tmp_path)
    assert main(["plugins", "effect"]) == 0
    assert main(["plugins", "effect", "--plugins", spiral_plugins.__path__[0]]) == 0
    assert "local plugins" not in capsys.readouterr().err


def test_a_sweep_names_them_once_for_all_its_jobs(folder, capsys):
    words = ["compare", "experiment=rotor_coastdown", "holdout=2,3", "n_jobs=1", "-m"]
    assert main([*words, "tracking.enabled=false", "--json", "-"]) == 2  # refused, each of them
    assert capsys.readouterr().err.count("plugins/own.py") == 1


def test_both_wishes_together_are_refused(folder, capsys, trace):
    assert main(["plugins", "--plugins", "plugins", "--no-plugins"]) == 2
    assert not trace.exists()


def test_what_is_named_is_what_is_run(folder):
    (folder / "_helper.py").write_text("raise SystemExit")
    (folder / "inner").mkdir()
    (folder / "inner" / "more.py").write_text("# nothing")
    named, registry = [str(path) for path in local_sources()], load_registry()
    assert [str(folder.parent / name) for name in named] == [file.file for file in registry.local]
    assert list(registry.local_plugins()) == ["effect/own_spring"]
    assert named == ["plugins/broken.py", "plugins/inner/more.py", "plugins/own.py"]
    assert local_sources(NO_FOLDER) == ()


def test_the_page_names_them_without_running_them(folder, tmp_path, monkeypatch, trace):
    monkeypatch.setattr(sessions, "Process", lambda *given: Mock())
    named = sessions.Session(tmp_path).local_plugins()
    assert named == ("plugins/broken.py", "plugins/own.py")
    assert sessions.Session(tmp_path, NO_FOLDER).local_plugins() == ()
    assert not trace.exists()

"""Compiled models are programs: only this user's own are loaded."""

import os
import stat
import subprocess
import sys
import textwrap

import pytest
from spiral_plugins.systems.oscillator import Oscillator

from spiral.physics import compile as compiler
from spiral.physics.trace import trace


@pytest.fixture
def shared(tmp_path, monkeypatch):
    """The place of the fallback in a temporary folder; the user's cache folder cannot be made."""
    (tmp_path / "no-folder").write_text("")
    monkeypatch.setenv("SPIRAL_CACHE", str(tmp_path / "no-folder"))
    monkeypatch.setattr(compiler.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(compiler.tempfile, "tempdir", str(tmp_path))
    compiler._own_folder.cache_clear()
    yield tmp_path / f"spiral-{os.getuid()}"
    compiler._own_folder.cache_clear()


def planted(folder):
    """Another user's file, whole and with its seal, in the place of a model."""
    system = Oscillator()
    name = f"spiral_model_{compiler._digest(trace(system, system.seed), None)}"
    source = "raise SystemExit('it ran')\n"
    (folder / f"{name}.py").write_text(compiler._seal(source) + source)
    return name


def test_a_folder_of_ones_own_is_used(shared):
    shared.mkdir(mode=0o700)
    assert compiler._kept(planted(shared)) is not None  # so that the refusals below say something
    path = compiler._written("spiral_model_other", "x = 1\n")
    assert path.parent == shared


def test_the_fallback_is_made_for_this_user_alone(shared):
    path = compiler._written("spiral_model_other", "x = 1\n")
    assert path.parent == shared
    assert stat.S_IMODE(os.lstat(shared).st_mode) == 0o700


@pytest.mark.parametrize("mode", [0o777, 0o770, 0o720, 0o702, 0o755])
def test_a_folder_that_others_can_enter_is_not_used(shared, mode):
    shared.mkdir()
    name = planted(shared)
    shared.chmod(mode)
    assert compiler._kept(name) is None
    assert compiler._written(name, "x = 1\n").parent not in (shared, shared.parent)


def test_a_link_in_the_folders_place_is_not_followed(shared, tmp_path):
    other = tmp_path / "other"
    other.mkdir(mode=0o700)
    name = planted(other)
    shared.symlink_to(other)
    assert compiler._kept(name) is None
    assert compiler._written(name, "x = 1\n").parent not in (shared, other)


def test_a_folder_of_another_user_is_not_used(shared, monkeypatch):
    shared.mkdir(mode=0o700)
    name = planted(shared)
    owner = os.lstat(shared).st_uid
    monkeypatch.setattr(compiler.os, "getuid", lambda: owner + 1)
    shared.rename(shared.with_name(f"spiral-{owner + 1}"))
    assert compiler._kept(name) is None


def test_a_cache_folder_that_all_can_write_to_is_not_used(tmp_path, monkeypatch):
    monkeypatch.setenv("SPIRAL_CACHE", str(tmp_path))
    place = compiler.cache_folder()
    place.mkdir(parents=True)
    name = planted(place)
    assert compiler._kept(name) is not None
    place.chmod(0o777)
    assert compiler._kept(name) is None


def test_the_folder_of_one_process_goes_with_it(tmp_path):
    """With the fallback taken by somebody else, a model is compiled, run, and nothing stays."""
    (tmp_path / "no-folder").write_text("")
    (tmp_path / f"spiral-{os.getuid()}").mkdir(mode=0o777)
    (tmp_path / f"spiral-{os.getuid()}").chmod(0o777)
    code = textwrap.dedent("""
        from spiral_plugins.systems.oscillator import Oscillator
        from spiral.physics import compile as compiler
        from spiral.physics.trace import trace
        path = compiler._written("spiral_model_x", "x = 1\\n")
        print(path)
    """)
    environment = {
        **os.environ,
        "TMPDIR": str(tmp_path),
        "SPIRAL_CACHE": str(tmp_path / "no-folder"),
    }
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert str(tmp_path) in done.stdout
    assert sorted(p.name for p in tmp_path.iterdir()) == ["no-folder", f"spiral-{os.getuid()}"]

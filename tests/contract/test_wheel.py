"""The wheel holds the whole of the three trees, so that no file works only in a checkout."""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TREES = {"spiral": "spiral", "plugins": "spiral_plugins", "conf": "spiral_conf"}
LEFT_OUT = shutil.ignore_patterns("__pycache__", "*.pyc", "*.nbi", "*.nbc", "*.tmp", ".*")


def _copy_sources(to: Path) -> None:
    """Build from a copy: a stale ``build/`` of the checkout would hide a forgotten file."""
    for folder in TREES:
        shutil.copytree(ROOT / folder, to / folder, ignore=LEFT_OUT)
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE"):
        if (ROOT / name).exists():
            shutil.copy(ROOT / name, to / name)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, zipfile.ZipFile]:
    """The copied sources and the wheel built from them, without network."""
    source = tmp_path_factory.mktemp("source")
    target = tmp_path_factory.mktemp("wheel")
    _copy_sources(source)
    options = ["--quiet", "--no-index", "--no-deps", "--no-build-isolation"]
    command = [sys.executable, "-m", "pip", "wheel", *options, "--wheel-dir", str(target), "."]
    done = subprocess.run(command, cwd=source, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (wheel,) = target.glob("spiral_po-*.whl")
    return source, zipfile.ZipFile(wheel)


def test_wheel_holds_every_file_of_the_three_trees(built: tuple[Path, zipfile.ZipFile]) -> None:
    source, wheel = built
    # The copy is taken before the build, which writes only build/ and *.egg-info beside the trees.
    expected = {
        f"{package}/{file.relative_to(source / folder).as_posix()}"
        for folder, package in TREES.items()
        for file in (source / folder).rglob("*")
        if file.is_file()
    }
    assert {"spiral/__init__.py", "spiral/py.typed", "spiral_plugins/__init__.py"} <= expected
    missing = sorted(expected - set(wheel.namelist()))
    assert not missing, (
        f"not in the wheel: {missing}; a package needs an __init__.py, "
        "another kind of file an entry in [tool.setuptools.package-data]"
    )


def test_wheel_holds_nothing_else(built: tuple[Path, zipfile.ZipFile]) -> None:
    _, wheel = built
    top = {name.split("/")[0] for name in wheel.namelist()}
    assert {name for name in top if not name.endswith(".dist-info")} == set(TREES.values())


def test_wheel_names_its_entry_points(built: tuple[Path, zipfile.ZipFile]) -> None:
    _, wheel = built
    (metadata,) = (n for n in wheel.namelist() if n.endswith(".dist-info/METADATA"))
    (points,) = (n for n in wheel.namelist() if n.endswith(".dist-info/entry_points.txt"))
    assert Parser().parsestr(wheel.read(metadata).decode())["Name"] == "spiral-po"
    text = wheel.read(points).decode()
    assert "spiral = spiral.cli:entry" in text
    assert "shipped = spiral_plugins" in text

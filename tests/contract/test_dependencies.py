"""What the package imports is what it declares, so that a fresh environment holds it."""

from __future__ import annotations

import ast
import re
import runpy
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
OWN = {"spiral", "spiral_plugins", "spiral_conf"}
# Distributions that come with another one by design: OmegaConf is Hydra's own configuration type.
BROUGHT_ALONG = {"omegaconf": "hydra-core"}


def _plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _declared() -> set[str]:
    with (ROOT / "pyproject.toml").open("rb") as file:
        listed = tomllib.load(file)["project"]["dependencies"]
    return {_plain(re.split(r"[^\w.-]", item, maxsplit=1)[0]) for item in listed}


def _extras() -> set[str]:
    """What the extras for users bring; imported inside functions alone, so lazily."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        extras = tomllib.load(file)["project"]["optional-dependencies"]
    listed = [item for name, items in extras.items() if name != "dev" for item in items]
    return {_plain(re.split(r"[^\w.-]", item, maxsplit=1)[0]) for item in listed}


def _lazy(tree: ast.Module) -> set[ast.AST]:
    """Nodes inside functions."""
    functions = (n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef))
    return {inner for function in functions for inner in ast.walk(function)}


def _imported() -> dict[str, str]:
    """Top-level names that the shipped trees import, each with a file that does."""
    found: dict[str, str] = {}
    providers, extras = packages_distributions(), _extras()
    for place in ("spiral", "plugins", "conf"):
        for path in sorted((ROOT / place).rglob("*.py")):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            lazy = _lazy(tree)
            for node in ast.walk(tree):
                names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
                if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                    names = [node.module]
                for name in (n.split(".")[0] for n in names):
                    if node in lazy and extras & {_plain(d) for d in providers.get(name, [name])}:
                        continue
                    found.setdefault(name, path.relative_to(ROOT).as_posix())
    return {n: f for n, f in found.items() if n not in OWN and n not in sys.stdlib_module_names}


def test_every_import_is_declared() -> None:
    declared = _declared()
    providers = packages_distributions()
    undeclared = {
        f"{name} ({file})"
        for name, file in _imported().items()
        if declared.isdisjoint(_plain(d) for d in providers.get(name, [name]))
        and BROUGHT_ALONG.get(name) not in declared
    }
    assert not undeclared, f"add to [project.dependencies], then `make lock`: {sorted(undeclared)}"


@pytest.mark.parametrize("name", ["requirements.lock", "requirements.hashes.lock"])
def test_every_dependency_is_in_the_first_part_of_the_lock(name: str) -> None:
    """``make setup`` installs that part alone."""
    first, mark, second = (ROOT / name).read_text(encoding="utf-8").partition("\n# For tests")
    locked = {_plain(line.split("==")[0]) for line in first.splitlines() if "==" in line}
    assert mark
    assert "playwright==" in second
    assert _declared() <= locked, f"run `make lock`: {sorted(_declared() - locked)}"


def test_the_lock_with_hashes_is_the_lock() -> None:
    text = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    hashed = (ROOT / "requirements.hashes.lock").read_text(encoding="utf-8")
    pins = {line for line in text.splitlines() if "==" in line}
    entries = re.findall(
        r"^(\S+==\S+) \\((?:\n    --hash=sha256:[0-9a-f]{64}(?: \\)?)+)$", hashed, re.M
    )
    assert {pin for pin, _ in entries} == pins, "run `make lock`"


@pytest.fixture(scope="module")
def licenses():
    """The program of ``make licenses``."""
    return runpy.run_path(str(ROOT / ".ci" / "licenses.py"))


@pytest.mark.parametrize(
    ("said", "kind"),
    [
        ("MIT", "free"), ("BSD-3-Clause AND MIT", "free"), ("Apache Software License", "free"),
        ("GPL-3.0-or-later", "copyleft"), ("GNU Lesser General Public License v3", "copyleft"),
        ("AGPL-3.0", "copyleft"), ("MIT OR GPL-2.0", "free"), ("MIT AND LGPL-2.1", "copyleft"),
        ("MPL-2.0", "by file"), ("", "unknown"), ("Our own terms", "unknown"),
    ],
)  # fmt: skip
def test_a_licence_is_what_it_says(licenses, said, kind):
    assert licenses["kind"](said) == kind


def test_nothing_that_the_program_runs_with_is_copyleft_or_of_unknown_licence(licenses, capsys):
    assert licenses["main"]() == 0
    lines = capsys.readouterr().out.splitlines()
    assert {"numpy", "mlflow-skinny", "starlette"} <= {line.split()[0] for line in lines[:-1]}
    assert " 0 copyleft, 0 unknown" in lines[-1]

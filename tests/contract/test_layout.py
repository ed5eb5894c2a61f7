"""The habits of the code, checked on every file: small, documented, free of any one machine."""

from __future__ import annotations

import ast
import re
import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TREES = ("spiral", "plugins", "experiments")
FUNCTION_LINES = 40
FILE_LINES = 500

LONG_FUNCTIONS = {
    # One compiled loop over windows, samples, substeps and stages: its work arrays live across all
    # of them, and a call per stage would hand over a dozen arrays each time.
    ("spiral/engine/kernel.py", "advance_windows"),
}

Function = ast.FunctionDef | ast.AsyncFunctionDef
FILES = sorted(
    path.relative_to(ROOT).as_posix() for tree in TREES for path in (ROOT / tree).rglob("*.py")
)


@cache
def _tree(name: str) -> ast.Module:
    return ast.parse((ROOT / name).read_text(encoding="utf-8"), filename=name)


def _functions(tree: ast.Module) -> Iterator[Function]:
    return (node for node in ast.walk(tree) if isinstance(node, Function))


def _lines(function: Function) -> int:
    """Lines from ``def`` to the last, the docstring not counted."""
    assert function.end_lineno is not None
    lines = function.end_lineno - function.lineno + 1
    if ast.get_docstring(function, clean=False) is None:
        return lines
    docstring = function.body[0]
    assert docstring.end_lineno is not None
    return lines - (docstring.end_lineno - docstring.lineno + 1)


def _public(body: list[ast.stmt]) -> Iterator[Function | ast.ClassDef]:
    """Public classes and functions of a module, with the public methods of those classes."""
    for node in body:
        if not isinstance(node, Function | ast.ClassDef) or node.name.startswith("_"):
            continue
        yield node
        if isinstance(node, ast.ClassDef):
            yield from _public(node.body)


def _overloaded(node: Function | ast.ClassDef) -> bool:
    """Whether the text belongs elsewhere: to the implementation, or to the overridden method."""
    names = {ast.unparse(d).rsplit(".", 1)[-1] for d in node.decorator_list}
    return not names.isdisjoint({"overload", "override", "setter"})


@pytest.mark.parametrize("name", FILES)
def test_file_is_under_the_limit(name: str) -> None:
    lines = len((ROOT / name).read_text(encoding="utf-8").splitlines())
    assert lines < FILE_LINES, f"{name}: {lines} lines, expected under {FILE_LINES}; split it"


@pytest.mark.parametrize("name", FILES)
def test_functions_are_under_the_limit(name: str) -> None:
    long = {
        f"{name}:{f.lineno} {f.name}: {_lines(f)} lines"
        for f in _functions(_tree(name))
        if _lines(f) >= FUNCTION_LINES and (name, f.name) not in LONG_FUNCTIONS
    }
    assert not long, f"expected under {FUNCTION_LINES} lines without the docstring: {sorted(long)}"


@pytest.mark.parametrize(("name", "function"), sorted(LONG_FUNCTIONS))
def test_listed_exception_is_still_one(name: str, function: str) -> None:
    sizes = [_lines(f) for f in _functions(_tree(name)) if f.name == function]
    assert any(size >= FUNCTION_LINES for size in sizes), "take it off LONG_FUNCTIONS"


@pytest.mark.parametrize("name", FILES)
def test_everything_public_has_a_docstring(name: str) -> None:
    tree = _tree(name)
    bare = [f"{name}: the module"] if ast.get_docstring(tree) is None else []
    bare += [
        f"{name}:{node.lineno} {node.name}"
        for node in _public(tree.body)
        if ast.get_docstring(node) is None and not _overloaded(node)
    ]
    assert not bare, f"without a docstring: {bare}"


# A folder of one machine at the start of a path, and settings that name a package host. The names
# are put together here so that this file does not find itself.
FOLDERS = "|".join(("work", "home", "root", "opt", "Users"))
MACHINE = re.compile(rf"(?<![\w.$)}}~/>-])/(?:{FOLDERS})/")
HOST = re.compile(
    "|".join(("index" + "-url", "find" + "-links", "python" + "hosted", "file:" + "//"))
)


def _checked_in() -> list[Path]:
    """Files of the repository, those not yet added too."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode != 0:
        pytest.skip("not a git checkout")
    files = (ROOT / name for name in listed.stdout.split("\0") if name)
    return [file for file in files if file.is_file() and not file.is_symlink()]


def test_no_file_names_a_machine_or_a_package_host() -> None:
    found = []
    for file in _checked_in():
        try:
            text = file.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
        for number, line in enumerate(text.splitlines(), 1):
            hit = MACHINE.search(line) or HOST.search(line)
            if hit:
                found.append(f"{file.relative_to(ROOT)}:{number}: {hit.group()}")
    assert not found, f"expected paths relative to the repository and no package host: {found}"


def test_lock_pins_every_version_and_nothing_else() -> None:
    lines = (ROOT / "requirements.lock").read_text(encoding="utf-8").splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    pinned = re.compile(r"[A-Za-z0-9][\w.-]*==[\w.!+]+")
    assert all(pinned.fullmatch(pin) for pin in pins), "expected NAME==VERSION on each line"
    names = [re.sub(r"[-_.]+", "-", pin.split("==")[0]).lower() for pin in pins]
    assert len(names) == len(set(names))
    assert {"pip", "setuptools", "wheel", "numpy", "numba", "pytest"} <= set(names)
    assert "spiral-po" not in names

"""A working skeleton of a plugin with its test: what ``spiral new KIND NAME`` writes."""

from __future__ import annotations

import ast
import importlib.util
import keyword
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from spiral.io.writing import fill_template
from spiral.types.errors import ConfigError, did_you_mean, near_misses
from spiral.types.plugin import snake_case

if TYPE_CHECKING:
    from spiral.io.registry import Registry

KINDS = (
    "system", "effect", "source", "derivative", "observer", "learner", "library", "gate",
    "strategy",
)  # fmt: skip


def new_plugin(kind: str, name: str, folder: Path, registry: Registry) -> tuple[Path, Path]:
    """Write ``NAME.py`` and ``test_NAME.py`` into a folder, made where it is missing.

    Raises
    ------
    ConfigError : an unknown kind, a name that is taken or is none, a file that is there already.
    """
    if kind not in KINDS:
        raise ConfigError(
            f"new {kind!r}", f"a kind: {', '.join(KINDS)}", f"{did_you_mean(kind, KINDS)}"
        )
    class_name = _class_name(kind, name)
    _check_name_free(kind, name, registry)
    texts = {
        folder / f"{name}.py": fill_template(kind, kind=kind, name=name, class_name=class_name),
        folder / f"test_{name}.py": fill_template(
            f"test_{kind}", kind=kind, name=name, class_name=class_name
        ),
    }
    for file in texts:
        if file.exists():
            raise ConfigError(
                f"new {kind} {name!r}, but {file} exists",
                "a name whose files are not there yet",
                "another name, another folder with --plugins DIR, or move that file away",
            )
    _write_files(folder, texts)
    source, test = texts
    return source, test


def _class_name(kind: str, name: str) -> str:
    """``my_spring`` -> ``MySpring``, where that gives the name back."""
    class_name = "".join(word.capitalize() for word in name.split("_"))
    given = f"new {kind} {name!r}"
    proper = re.sub(r"[^a-z0-9]+", "_", snake_case(name)).strip("_0123456789")
    if not re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", name) or keyword.iskeyword(name):
        hint = f"spiral new {kind} {proper}" if proper and not keyword.iskeyword(proper) else ""
        raise ConfigError(given, "a name in snake_case, for instance my_spring", hint)
    if snake_case(class_name) != name:
        raise ConfigError(
            given,
            f"a name that its class {class_name} gives back",
            f"spiral new {kind} {snake_case(class_name)}",
        )
    if name.startswith("test_"):
        raise ConfigError(
            given,
            "a name that does not start with test_, as tests do",
            f"spiral new {kind} {name.removeprefix('test_')}",
        )
    if (
        class_name in _imported_names(kind)
        or name in sys.stdlib_module_names
        or _is_installed(name)
    ):
        raise ConfigError(
            given,
            "a name that no Python module and no class of spiral has",
            f"spiral new {kind} my_{name}",
        )
    return class_name


def _is_installed(name: str) -> bool:
    spec = importlib.util.find_spec(name)
    return spec is not None and spec.origin is not None


def _imported_names(kind: str) -> set[str]:
    """Names that a skeleton imports, which its class must not hide."""
    tree = ast.parse(fill_template(kind, kind=kind, name="name", class_name="Name"))
    return {
        alias.asname or alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
        for alias in node.names
    }


def _check_name_free(kind: str, name: str, registry: Registry) -> None:
    for entry in registry.entries:
        if entry.name == name:
            raise ConfigError(
                f"new {kind} {name!r}, the name of the {entry.kind} in {entry.file}",
                "a name that no plugin has",
                f"another name, or spiral check {name} for the one that is there",
            )


def _write_files(folder: Path, texts: dict[Path, str]) -> None:
    """All files or none."""
    from spiral.io.writing import write_whole

    made = [p for p in (folder, *folder.parents) if not p.exists()]
    done: list[Path] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file, text in texts.items():
            write_whole(file, text)
            done.append(file)
    except OSError as error:
        for file in done:
            file.unlink(missing_ok=True)
        for path in made:
            if path.is_dir():
                path.rmdir()
        raise ConfigError(
            f"folder {str(folder)!r}: {error.strerror or error}",
            "a folder that can be written",
            "--plugins DIR",
        ) from error


def similar_plugins(name: str, registry: Registry) -> list[str]:
    """Plugins with names near to a new one, which may already be what is wanted."""
    return near_misses(name, [e.name for e in registry.entries if e.name != name])

"""The registry of plugins, from installed packages and from a local folder.

A plugin is a concrete subclass of one of the abstract kinds, defined in a loaded module. There is
no global registry: ``load_registry`` returns a value that is passed on.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import importlib.machinery
import importlib.util
import inspect
import os
import pkgutil
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from spiral.io.programs import refuse_program
from spiral.io.system_files import plugin_of_file
from spiral.types.errors import ConfigError, PluginError, SpiralError, did_you_mean
from spiral.types.fields import construct
from spiral.types.label import split_port
from spiral.types.plugin import Plugin, is_concrete

if TYPE_CHECKING:
    from spiral.types.effect import Effect
    from spiral.types.system import System

GROUP = "spiral.plugins"
FOLDER_VARIABLE = "SPIRAL_PLUGINS"
DEFAULT_FOLDER = "plugins"
LOCAL = "local"  # the origin of a plugin that comes from a folder
NO_FOLDER = ""  # in place of a folder: no local plugins, whatever the variable and ./plugins hold


@dataclass(frozen=True)
class Entry:
    """One plugin: its kind, name and class, where it is defined, and in which version."""

    kind: str
    name: str
    plugin: type[Plugin]
    file: str
    origin: str
    version: str


@dataclass(frozen=True)
class Failure:
    """A plugin file that could not be used, and why."""

    name: str
    file: str
    message: str


@dataclass(frozen=True)
class LocalFile:
    """A file of a local folder that was run, with the SHA-256 of the text that was run."""

    file: str
    sha256: str


@dataclass(frozen=True)
class Registry:
    """Every known plugin; the allowlist of what a configuration may name.

    ``local``: files of the local folder that were run, those that failed too. ``programs``: files
    that the user named to be run as a model (``spiral.io.programs``).
    """

    entries: tuple[Entry, ...]
    failures: tuple[Failure, ...] = field(default=())
    local: tuple[LocalFile, ...] = field(default=())
    programs: frozenset[str] = frozenset()

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds that have a plugin."""
        return tuple(sorted({e.kind for e in self.entries}))

    def names(self, kind: str) -> tuple[str, ...]:
        """Names of one kind, sorted."""
        return tuple(sorted(e.name for e in self.entries if e.kind == kind))

    def entry(self, kind: str, name: str) -> Entry:
        """A plugin by kind and name.

        Raises
        ------
        ConfigError : unknown; near misses and files that failed to import are named.
        """
        for entry in self.entries:
            if entry.kind == kind and entry.name == name:
                return entry
        names = self.names(kind)
        expected = f"one of {', '.join(names) or 'none'}"
        raise ConfigError(f"{kind} {name!r}", expected, self._hint(name, names))

    def named(self, name: str) -> tuple[Entry, ...]:
        """Plugins of any kind by name.

        Raises
        ------
        ConfigError : unknown; near misses and files that failed to import are named.
        """
        matches = tuple(e for e in self.entries if e.name == name)
        if not matches:
            names = tuple(e.name for e in self.entries)
            expected = "the name of a plugin; spiral plugins lists them"
            raise ConfigError(f"plugin {name!r}", expected, self._hint(name, names))
        return matches

    def _hint(self, name: str, names: tuple[str, ...]) -> str:
        if name.endswith(".py"):
            return "system=FILE.py on the command line, spiral.system('FILE.py') in Python"
        for failure in self.failures:
            if name in (failure.name, Path(failure.file).stem):
                return f"{failure.file} could not be used: {failure.message}"
        return did_you_mean(name, names)

    def make(
        self, kind: str, name: str, fields: Mapping[str, Any] | None = None, where: str = ""
    ) -> Any:
        """A plugin's instance from plain field values; ``where`` is what messages call it.

        A system may be named by its file.
        """
        if kind == "system" and plugin_of_file(name):
            name, fields = plugin_of_file(name), {"path": name, **(fields or {})}
        plugin = self.entry(kind, name).plugin
        refuse_program(plugin, fields or {}, self.programs)
        return construct(plugin, fields or {}, where or name, self.resolve)

    def simulation(self, fields: Mapping[str, Any]) -> Any:
        """The source ``record=simulation`` with these fields."""
        return self.make("source", "simulation", fields, "record")

    def resolve(self, kind: type, given: Any, where: str) -> Any:
        """A plugin named inside a field: a name, a label, or ``{name: ..., fields...}``."""
        fields: dict[str, Any] = dict(given) if isinstance(given, Mapping) else {"name": given}
        name = fields.pop("name", None)
        if not isinstance(name, str):
            raise ConfigError(f"{where}={given!r}", f"the name of a {kind.kind}")  # type: ignore[attr-defined]
        if kind.kind == "effect":  # type: ignore[attr-defined]
            return self.effect_from_label(name, fields)
        return self.make(kind.kind, name, fields)  # type: ignore[attr-defined]

    def effect_from_label(self, label: str, fields: Mapping[str, Any] | None = None) -> Effect:
        """``cubic_stiffness@bearing_2`` and further fields -> the effect."""
        name, port = split_port(label)
        own = {"port": port} if port else {}
        return self.make("effect", name, {**(fields or {}), **own})

    def candidates(self, system: System, everywhere: bool = False) -> tuple[Effect, ...]:
        """Named effects that fit the system's first port, or (``everywhere``) any place of it."""
        from spiral.types.effect import (
            Effect,
            InputEffect,
            ParameterEffect,
            SensorEffect,
            StateFlow,
        )
        from spiral.types.placement import at_every_place, fits

        effects: list[Effect] = []
        for name in self.names("effect"):
            plugin = self.entry("effect", name).plugin
            if not issubclass(plugin, Effect) or plugin.bare:
                continue
            varying = issubclass(plugin, ParameterEffect) and not plugin.steady
            if varying:  # tried where no candidate explains what is left
                continue
            driven = issubclass(plugin, SensorEffect) and bool(plugin.driver)
            placed = driven or issubclass(plugin, InputEffect | StateFlow | ParameterEffect)
            if placed and not everywhere:
                continue
            places = at_every_place(system, plugin()) if everywhere else (plugin(),)
            effects += [e for e in places if fits(system, e)]
        return tuple(effects)

    def varying(self) -> tuple[Effect, ...]:
        """The forms in which a parameter may follow a variable, without a place; a curve is one."""
        from spiral.types.effect import ParameterEffect

        plugins = (self.entry("effect", name).plugin for name in self.names("effect"))
        changing = (p for p in plugins if issubclass(p, ParameterEffect) and not p.steady)
        return tuple(plugin() for plugin in changing)

    def dictionary(self, system: System) -> tuple[Effect, ...]:
        """Learned effects (``spiral.physics.learned``) at every place where they fit.

        Those at the first port come first, without its name. A flow into any state is left out
        where there are curves for flows between named channels; a parameter that follows a variable
        by a curve is one of ``varying``.
        """
        from spiral.physics.learned import (
            Learned,
            LearnedFlow,
            LearnedParameterChange,
            LearnedStateFlow,
        )
        from spiral.types.placement import at_fitting_places

        plugins = (self.entry("effect", name).plugin for name in self.names("effect"))
        curves = tuple(
            plugin()
            for plugin in plugins
            if issubclass(plugin, Learned) and not issubclass(plugin, LearnedParameterChange)
        )
        effects = at_fitting_places(system, curves)
        named = any(isinstance(e, LearnedFlow) for e in effects)
        kept = (e for e in effects if not (named and isinstance(e, LearnedStateFlow)))
        return tuple(sorted(kept, key=lambda e: bool(e.port)))

    def local_plugins(self) -> dict[str, LocalFile]:
        """``kind/name`` -> the file that was run for it, of every plugin of the local folder."""
        files = {f.file: f for f in self.local}
        own = (e for e in self.entries if e.file in files)
        return {f"{e.kind}/{e.name}": files[e.file] for e in own}

    def versions(self) -> dict[str, str]:
        """``kind/name`` -> version, for the history of a run."""
        return {f"{e.kind}/{e.name}": f"{e.origin} {e.version}".strip() for e in self.entries}


def load_registry(folder: str | os.PathLike[str] | None = None, local: bool = True) -> Registry:
    """Load installed plugins and those of a local folder.

    Parameters
    ----------
    folder : left out, ``SPIRAL_PLUGINS``, else ``./plugins`` where there is one; none where
        ``NO_FOLDER``.
    local : whether to read a local folder at all.

    Raises
    ------
    ConfigError : a folder was named and is not there.
    PluginError : two plugins of one kind have one name.
    """
    modules: list[tuple[ModuleType, str, str]] = []
    failures: list[Failure] = []
    for package, origin, version in _import_installed(failures):
        modules += [(m, origin, version) for m in _import_modules(package, failures)]
    files: list[LocalFile] = []
    for path in local_sources(folder) if local else ():
        module = _run_local_file(path, files, failures)
        if module is not None:
            modules.append((module, LOCAL, files[-1].sha256[:12]))
    return Registry(_collect_entries(modules, failures), tuple(failures), tuple(files))


def local_sources(folder: str | os.PathLike[str] | None = None) -> tuple[Path, ...]:
    """The files of the local folder that ``load_registry`` runs, in order; none is run here.

    Files of an installed package of plugins are left out: they are loaded as such.

    Raises
    ------
    ConfigError : a folder was named and is not there.
    """
    place = _local_folder(folder)
    if place is None:
        return ()
    installed = _installed_folders()

    def is_plugin_file(path: Path) -> bool:
        inside = path.relative_to(place).parts
        hidden = any(part.startswith(("_", ".", "test_")) for part in inside)
        return not hidden and installed.isdisjoint(path.resolve().parents)

    return tuple(path for path in sorted(place.rglob("*.py")) if is_plugin_file(path))


def _installed_folders() -> set[Path]:
    """Folders of the installed packages of plugins; nothing is imported."""
    from importlib.metadata import entry_points

    folders: set[Path] = set()
    for point in entry_points(group=GROUP):
        with contextlib.suppress(ImportError, ValueError):
            spec = importlib.util.find_spec(point.module)
            folders |= {Path(p).resolve() for p in (spec and spec.submodule_search_locations) or ()}
    return folders


def _import_installed(failures: list[Failure]) -> Iterator[tuple[ModuleType, str, str]]:
    from importlib.metadata import entry_points

    for point in entry_points(group=GROUP):
        origin = point.dist.name if point.dist else point.name
        version = point.dist.version if point.dist else ""
        try:
            yield importlib.import_module(point.module), origin, version
        except Exception as error:
            failures.append(Failure(point.name, point.value, error_summary(error)))


def _import_modules(package: ModuleType, failures: list[Failure]) -> Iterator[ModuleType]:
    """The package and all modules under it; those that fail are reported by name and file."""
    yield package
    if not hasattr(package, "__path__"):
        return
    prefix = f"{package.__name__}."
    for info in pkgutil.walk_packages(package.__path__, prefix, onerror=lambda name: None):
        spec = importlib.util.find_spec(info.name)
        file = spec.origin if spec and spec.origin else info.name
        try:
            yield importlib.import_module(info.name)
        except (Exception, SystemExit) as error:
            failures.append(Failure(info.name.rsplit(".", 1)[-1], file, error_summary(error)))


def _local_folder(folder: str | os.PathLike[str] | None) -> Path | None:
    if folder == NO_FOLDER:
        return None
    given = folder or os.environ.get(FOLDER_VARIABLE)
    if not given:
        default = Path(DEFAULT_FOLDER)
        return default if default.is_dir() else None
    path = Path(given).expanduser()
    if not path.is_dir():
        raise ConfigError(
            f"plugin folder {str(given)!r}",
            "a folder with Python files",
            f"--plugins DIR, or unset {FOLDER_VARIABLE}",
        )
    return path


class _HashedSource(importlib.machinery.SourceFileLoader):
    """Runs the very text that was hashed: no ``__pycache__`` of a folder can take its place."""

    text = b""

    def get_code(self, fullname: str) -> Any:
        """The code of the text."""
        return self.source_to_code(self.text, self.path)


def _run_local_file(
    path: Path, files: list[LocalFile], failures: list[Failure]
) -> ModuleType | None:
    """Run one local file and note its hash; one that fails is reported by name and file."""
    name = f"spiral_local_{hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:10]}"
    name = f"{name}_{path.stem}"
    file = str(path.absolute())
    loader = _HashedSource(name, file)
    spec = importlib.util.spec_from_file_location(name, file, loader=loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up by name
    try:
        loader.text = path.read_bytes()
        files.append(LocalFile(file, hashlib.sha256(loader.text).hexdigest()))
        loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        failures.append(Failure(path.stem, str(path), error_summary(error)))
        return None
    return module


def error_summary(error: BaseException) -> str:
    """An error in one line, with the place in the plugin's file where there is one."""
    if isinstance(error, SpiralError):
        return f"{error.given}; expected {error.expected}"
    place = f", line {error.lineno}" if isinstance(error, SyntaxError) else _error_place(error)
    return f"{type(error).__name__}: {(str(error).splitlines() or [''])[0]}{place}"


def _error_place(error: BaseException) -> str:
    frame = error.__traceback__
    last = ""
    while frame is not None:
        if "importlib" not in frame.tb_frame.f_code.co_filename:
            last = f" ({Path(frame.tb_frame.f_code.co_filename).name}, line {frame.tb_lineno})"
        frame = frame.tb_next
    return last


def _collect_entries(
    modules: list[tuple[ModuleType, str, str]], failures: list[Failure]
) -> tuple[Entry, ...]:
    by_key: dict[tuple[str, str], Entry] = {}
    unfinished: dict[type, str] = {}
    for module, origin, version in modules:
        for cls in _plugin_classes(module):
            file = str(module.__file__)
            if not is_concrete(cls):
                unfinished[cls] = file
                continue
            entry = Entry(cls.kind, cls.plugin_name(), cls, file, origin, version)
            first = by_key.setdefault((entry.kind, entry.name), entry)
            if first is not entry:
                raise PluginError(
                    f"{entry.kind} {entry.name!r} twice: in {first.file} and in {entry.file}",
                    "each name once",
                    "rename one of the two classes",
                )
    failures += [
        Failure(cls.plugin_name(), file, f"{cls.__name__} does not define {_missing_methods(cls)}")
        for cls, file in unfinished.items()
        if not cls.__subclasses__()
    ]
    return tuple(sorted(by_key.values(), key=lambda e: (e.kind, e.name)))


def _plugin_classes(module: ModuleType) -> list[type[Plugin]]:
    return [
        c
        for c in vars(module).values()
        if inspect.isclass(c)
        and issubclass(c, Plugin)
        and c.kind
        and c.__module__ == module.__name__
    ]


def _missing_methods(cls: type) -> str:
    return ", ".join(sorted(getattr(cls, "__abstractmethods__", ())))

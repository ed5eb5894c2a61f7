"""Former names of modules, from before the packages ``types/``, ``engine/``, ``io/`` existed.

Plugin files of users that import by them keep working: ``from spiral.effect import ForceEffect``
gives the module ``spiral.types.effect``. New files import from ``spiral`` itself.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

FORMER = {
    **{
        name: f"types.{name}"
        for name in (
            "derivative", "effect", "errors", "fields", "learner", "library", "model", "parameter",
            "plugin", "port", "record", "source", "system", "units",
        )
    },
    "trace": "physics.trace",
    "projection": "physics.projection",
    "learned": "physics.learned",
    "leastsquares": "engine.leastsquares",
    "gate": "engine.gate",
    "observer": "engine.filter.observer",
    "filtering": "engine.filter",
    "excitation": "inference.excitation",
    "reading": "io.readers",
    "registry": "io.registry",
    "testing": "io.testing",
    "conformance": "io.conformance",
}  # fmt: skip
"""Former name -> present one, both below ``spiral``; the modules of a package with it."""


RENAMED = {
    "spiral.io.conformance.rehearsal": "spiral.io.conformance.regression",
    "spiral.engine.filter.likelihood": "spiral.engine.filter.innovation_fit",
    "spiral.io.readers.readers": "spiral.io.readers.formats",
    "spiral.io.readers.files": "spiral.io.readers.table",
    "spiral.io.readers.preparation": "spiral.io.readers.rotor_series",
}
"""Modules below those that have another name of their own now."""


CALLED = {"spiral.types.system": "spiral.io.own_model"}
"""Modules whose former name is now also that of a function -> the module of that function."""


def present(name: str) -> str | None:
    """The present full name of a module by its former one; nothing where it never moved."""
    package, _, below = name.partition(".")
    parts = below.split(".")
    if package != "spiral" or parts[0] not in FORMER:
        return None
    moved = ".".join(("spiral", FORMER[parts[0]], *parts[1:]))
    return RENAMED.get(moved, moved)


class _Called(ModuleType):
    """A callable module: imported by its former name it hides the function of that name."""

    def __call__(self, *given: Any, **named: Any) -> Any:
        """The function of ``spiral`` with the module's former name."""
        home = importlib.import_module(CALLED[self.__name__])
        return getattr(home, self.__name__.rpartition(".")[2])(*given, **named)


class _Loader(Loader):
    """Gives the module of one present name under a former one too; it runs only once."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.spec: ModuleSpec | None = None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        module = importlib.import_module(self.name)
        self.spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """It has run already; the import system has put the former name on it."""
        module.__spec__ = self.spec
        if self.name in CALLED:
            module.__class__ = _Called


class FormerNames(MetaPathFinder):
    """Finds modules by their former names, before others look in the folder of a former package."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """A spec where the name is a former one."""
        present_name = present(fullname)
        if present_name is None or importlib.util.find_spec(present_name) is None:
            return None
        return ModuleSpec(fullname, _Loader(present_name))


def accept() -> None:
    """Accept former names in this process."""
    if not any(isinstance(f, FormerNames) for f in sys.meta_path):
        sys.meta_path.insert(0, FormerNames())

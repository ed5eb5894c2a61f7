"""The base of every plugin: classes are abstract or final, and final ones frozen dataclasses."""

from __future__ import annotations

import inspect
import re
from abc import ABC
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, dataclass_transform

_SHIPPED = "spiral_plugins"  # the package of those that come with it


@lru_cache(maxsize=1024)
def snake_case(name: str) -> str:
    """``CubicStiffness`` -> ``cubic_stiffness``."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name).lower()


@dataclass_transform(frozen_default=True)
class Plugin(ABC):  # noqa: B024  (its subclasses, the kinds, have the abstract methods)
    """Something chosen by name in a configuration.

    A plugin is a concrete subclass of one of the abstract kinds; its name is the snake_case of
    its class, its fields are dimensionless choices and become the configuration's fields.
    """

    kind: ClassVar[str] = ""
    program: ClassVar[str] = ""
    """Field that names a file which is run, where there is one."""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        dataclass(frozen=True)(cls)

    @classmethod
    def plugin_name(cls) -> str:
        """The name used in configurations."""
        return snake_case(cls.__name__)

    @classmethod
    def is_shipped(cls) -> bool:
        """Whether it comes with the package, whose own tests trace and evaluate it."""
        return cls.__module__.partition(".")[0] == _SHIPPED

    @classmethod
    def meaning(cls) -> str:
        """The first line of the docstring: what it is, in one line."""
        lines = (inspect.cleandoc(cls.__doc__ or "")).splitlines()
        return lines[0] if lines else ""


def is_concrete(cls: type) -> bool:
    """Whether a class can be instantiated, so is a plugin rather than a kind."""
    return not inspect.isabstract(cls)

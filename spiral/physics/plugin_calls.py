"""Calls of a plugin's equation, with errors that name the plugin and the line."""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from spiral.types.effect import Effect
from spiral.types.errors import PluginError, SpiralError
from spiral.types.system import System


def call_equation(
    owner: Effect | System, what: str, function: Callable[..., Any], *given: Any
) -> Any:
    """A plugin's equation at symbols or arrays; an error names the plugin and the line."""
    try:
        return function(*given)
    except SpiralError:
        raise
    except Exception as error:
        place, frames = "", traceback.extract_tb(error.__traceback__)
        own = inspect.getsourcefile(type(owner))
        for frame in (f for f in frames if f.filename == own):
            place = f" ({Path(frame.filename).name}, line {frame.lineno})"
        name = owner.plugin_name()
        raise PluginError(
            f"{what}() of {owner.kind} {name!r}{place}: {type(error).__name__}: "
            f"{(str(error).splitlines() or [''])[0]}",
            "one expression for all states, numbers and symbols alike",
            "spiral.math has where(condition, a, b) in place of if, and sin, cos, tanh, exp, sqrt, "
            f"maximum; then spiral check {name}",
        ) from error

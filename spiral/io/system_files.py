"""Systems that are files: ``system=two_masses.yaml`` in place of a plugin's name."""

from __future__ import annotations

from pathlib import Path

PLUGINS = {".yaml": "equations", ".yml": "equations", ".toml": "equations", ".json": "equations",
           ".npz": "structure", ".mat": "structure", ".fmu": "fmu",
           ".xml": "robot", ".urdf": "robot"}  # fmt: skip
"""End of a file's name -> the system that reads it as its ``path``."""
PYTHON = ".py"
"""End of the name of a file that is run for the system which it defines."""
PROGRAMS = ("fmu",)
"""Those of them that run it."""


def plugin_of_file(name: str) -> str:
    """The system that reads a file of this name; empty where it is no such file's name."""
    return PLUGINS.get(Path(name).suffix.lower(), "")


def is_python_file(name: str) -> bool:
    """Whether a file of this name is Python, which is run for the system that it defines."""
    return Path(name).suffix.lower() == PYTHON


def is_model_file(name: str) -> bool:
    """Whether a name is that of a file which holds a system."""
    return bool(plugin_of_file(name)) or is_python_file(name)

"""Systems that are files: ``system=two_masses.yaml`` in place of a plugin's name."""

from __future__ import annotations

from pathlib import Path

PLUGINS = {".yaml": "equations", ".yml": "equations", ".toml": "equations", ".json": "equations",
           ".npz": "structure", ".mat": "structure", ".fmu": "fmu",
           ".xml": "robot", ".urdf": "robot"}  # fmt: skip
"""End of a file's name -> the system that reads it as its ``path``."""
PROGRAMS = ("fmu",)
"""Those of them that run it."""


def plugin_of_file(name: str) -> str:
    """The system that reads a file of this name; empty where it is no such file's name."""
    return PLUGINS.get(Path(name).suffix.lower(), "")

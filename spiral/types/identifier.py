"""Names from other programs as Python identifiers."""

from __future__ import annotations

import keyword
import re


def identifier(told: str, taken: set[str]) -> str:
    """A name as an identifier not ``taken``: ``load.flange[1]`` -> ``load_flange_1``."""
    name = re.sub(r"\W+", "_", told, flags=re.ASCII).strip("_") or "value"
    if name[0].isdigit() or keyword.iskeyword(name) or name in ("t", "time", "pi"):
        name = f"value_{name}"
    while name in taken:
        name += "_2"
    return name

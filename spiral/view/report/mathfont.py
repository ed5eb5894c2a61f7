"""The font of equations: with it dots over letters and powers stand where mathematics has them."""

from __future__ import annotations

from base64 import b64encode
from functools import lru_cache
from importlib.resources import files


@lru_cache(maxsize=1)
def math_style() -> str:
    """A rule for ``math`` elements that brings its font along, since a report is one file."""
    font = files("spiral.view.report") / "fonts" / "STIXTwoMath-subset.woff"
    text = b64encode(font.read_bytes()).decode()
    return (
        f"@font-face{{font-family:'Equations';src:url(data:font/woff;base64,{text})}}"
        "math{font-family:'Equations',math;font-size:20px}"
        "math mtd{text-align:-webkit-left;padding:.15em .3em}"
        "math mover>mo{font-weight:bold;font-size:1.3em}"  # one dot or two, seen at a glance
    )

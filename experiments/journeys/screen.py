"""What stands on the page, and the least that is done to it."""

from __future__ import annotations

import re
from typing import Any


def error(page: Any) -> list[float]:
    """The free-run error shown, in percent: now, and before anything was added."""
    return [float(x) for x in re.findall(r"([\d.]+)\s*%", page.inner_text("#error-now"))]


def settled(page: Any) -> None:
    """Wait until nothing fades in or out any more: only then has it its colours.

    Another colour scheme is told to the page with a frame, and fades begin with the next.
    """
    page.evaluate("new Promise(r => requestAnimationFrame(() => requestAnimationFrame(r)))")
    page.wait_for_function("document.getAnimations().every(a => a.playState !== 'running')")


def faults(page: Any, part: Any = None, **options: Any) -> list[tuple[str, list[Any]]]:
    """What axe-core has against the page as it is, or against a part of it."""
    from axe_playwright_python.sync_playwright import Axe

    settled(page)
    options["resultTypes"] = ["violations"]  # not every element of what is right
    found = Axe().run(page, part, options).response["violations"]
    return [(v["id"], [n["target"] for n in v["nodes"]]) for v in found]


def drag(page: Any, first: float, last: float) -> None:
    """Drag over a share of the width of the picture of a file's columns."""
    box = page.locator("#plot-columns .nsewdrag").nth(1).bounding_box()
    height = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + first * box["width"], height)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.5 * (first + last) * box["width"], height, steps=5)
    page.mouse.move(box["x"] + last * box["width"], height, steps=5)
    page.mouse.up()

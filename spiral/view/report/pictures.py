"""A figure as PNG, a whole report as PDF: drawn by a browser without a window."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from spiral.types.errors import InputError

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome", "msedge")
VARIABLE = "SPIRAL_BROWSER"
_PATIENCE = 90.0  # s
_PAPER = "1122,1587"  # A3 in pixels: as wide as the report


def find_browser() -> str | None:
    """A browser that can run without a window: ``SPIRAL_BROWSER``, or one on the path."""
    return os.environ.get(VARIABLE) or next((b for b in map(shutil.which, BROWSERS) if b), None)


def write_png(html: str, target: Path, width: int = 1060, height: int = 600) -> Path:
    """Write a PNG of a page with no network.

    Raises
    ------
    InputError : no browser, or one that draws nothing.
    """
    return _run_browser(html, target, f"--window-size={width},{height}", "--screenshot")


def write_pdf(html: str, target: Path) -> Path:
    """Write a PDF of a page with no network, on paper of the size that the page asks for.

    Raises
    ------
    InputError : no browser, or one that prints nothing.
    """
    return _run_browser(html, target, f"--window-size={_PAPER}", "--no-pdf-header-footer",
                    "--print-to-pdf")  # fmt: skip


def _run_browser(html: str, target: Path, *flags: str) -> Path:
    """Have a browser without a window write a page; the last flag takes the file's name."""
    program = find_browser()
    if program is None:
        raise InputError("no browser", f"one of {', '.join(BROWSERS)}", f"set {VARIABLE}")
    target.unlink(missing_ok=True)
    with tempfile.TemporaryDirectory() as place:
        page = Path(place) / "page.html"
        page.write_text(html, encoding="utf-8")
        command = [
            program, "--headless=new", "--no-sandbox", "--hide-scrollbars", "--disable-gpu",
            "--virtual-time-budget=10000", f"--user-data-dir={place}/profile",
            *flags[:-1], f"{flags[-1]}={target.resolve()}", page.as_uri(),
        ]  # fmt: skip
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=_PATIENCE, check=False
        )
    if not target.is_file():
        raise InputError(
            f"{program} wrote nothing: {done.stderr[-300:]}", f"a file {target.suffix}",
            f"set {VARIABLE}",
        )  # fmt: skip
    return target

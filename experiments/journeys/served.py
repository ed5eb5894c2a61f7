"""The page's program as a person starts it, and the browser that looks at it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

SIZE = {"width": 1366, "height": 900}
PATIENCE = 120_000  # ms, on a machine that does other things too
HARMLESS = (
    "Failed to load resource",  # a refusal that is asked for
    "Resize must be passed a displayed plot",  # NiceGUI measures a figure that has just gone
)
"""Errors in the console that are none of the page's own."""


class Served:
    """``spiral app`` on a free port; ``out`` is its folder of runs."""

    def __init__(self, out: Path, variables: Mapping[str, str] | None = None) -> None:
        self.out = out
        self.variables = dict(variables or {})
        self.start()

    def start(self) -> None:
        """Start the program and read the address that it prints."""
        command = [sys.executable, "-m", "spiral", "app", "--port", "0", "--no-browser"]
        self.process = subprocess.Popen(
            [*command, f"out={self.out}"], stdout=subprocess.PIPE, text=True, cwd=self.out,
            env={**os.environ, **self.variables},
        )  # fmt: skip
        line = self.process.stdout.readline() if self.process.stdout else ""
        assert "http://127.0.0.1:" in line, line
        self.entry = line.split()[2]
        self.address, _, self.token = self.entry.partition("/?token=")
        self.port = int(self.address.rsplit(":", 1)[1])

    def enter(self, page: Any) -> Any:
        """Give a page the cookie that opening the printed address would."""
        page.context.add_cookies([
            {"name": f"spiral-{self.port}", "value": self.token, "url": self.address,
             "httpOnly": True, "sameSite": "Strict"}
        ])  # fmt: skip
        return page

    def stop(self) -> None:
        """End the program as Ctrl-C does; one that does not end is killed, and that is an error."""
        self.process.send_signal(signal.SIGINT)
        try:
            self.process.wait(15)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise


def open_browser(playwright: Any, program: str, profile: Path) -> Any:
    """A window of Chromium that keeps what it has fetched and compiled, as a person's does.

    Nothing in it moves (``prefers-reduced-motion``), so that nothing has to be waited for.
    """
    flags = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    window = playwright.chromium.launch_persistent_context(
        profile, executable_path=program, args=flags, viewport=SIZE, reduced_motion="reduce",
    )  # fmt: skip
    window.set_default_timeout(PATIENCE)
    return window

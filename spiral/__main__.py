"""``python -m spiral``."""

from spiral.cli import entry

entry()

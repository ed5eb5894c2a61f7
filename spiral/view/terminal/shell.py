"""Command lines that a person can copy into a shell."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import Any


def quote_word(text: str) -> str:
    """A word quoted for a shell; in double quotes if it has single ones and that is safe."""
    if "'" in text and not set(text) & set('"$`\\!'):
        return f'"{text}"'
    return shlex.quote(text)


def join_command(*words: str) -> str:
    """Words quoted and joined to one command line."""
    return " ".join(map(quote_word, words))


def option_lines(overrides: Sequence[Any]) -> str:
    """Options of a command, each on a line of its own."""
    return "".join(f" \\\n    {quote_word(str(o))}" for o in overrides)

"""Command lines that a person can copy into a shell."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import Any


def word(text: str) -> str:
    """One word of a shell: within double quotes where it holds single ones, if these do no harm."""
    if "'" in text and not set(text) & set('"$`\\!'):
        return f'"{text}"'
    return shlex.quote(text)


def spoken(*words: str) -> str:
    """A command line on one line."""
    return " ".join(map(word, words))


def option_lines(overrides: Sequence[Any]) -> str:
    """Options of a command, each on a line of its own."""
    return "".join(f" \\\n    {word(str(o))}" for o in overrides)

"""How texts of a model get into files of other languages: as words, as plain lines, as LaTeX.

Names, units and labels may come from a saved run of anyone, and must neither end the comment or
the string that they stand in nor be taken for a command.
"""

from __future__ import annotations

import re

_LONGEST_WORD, _LONGEST_TEXT = 56, 200  # MATLAB cuts names behind 63 characters
_LATEX = {"_": r"\_", "#": r"\#", "%": r"\%", "&": r"\&", "$": r"\$", "{": r"\{", "}": r"\}",
          "^": r"\^{}", "~": r"\~{}"}  # fmt: skip


def ascii_identifier(text: str) -> str:
    """ASCII letters, digits and underscores, the first no digit; nothing where none is left."""
    cleaned = re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_")[:_LONGEST_WORD]
    return f"n{cleaned}" if cleaned[:1].isdigit() else cleaned


def sanitise_text(text: str) -> str:
    """One line without quotes, escapes and marks of comments: safe in a comment or a string."""
    one = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    one = one.replace("\\", "/").replace('"', "'").replace("'''", "' ' '")
    one = re.sub(r"\?(?=\?)", "? ", one)
    while "*/" in one or "/*" in one:
        one = one.replace("*/", "* /").replace("/*", "/ *")
    return one[:_LONGEST_TEXT]


def latex_text(text: str) -> str:
    """A plain line in which LaTeX sees characters only."""
    return "".join(_LATEX.get(c, c) for c in sanitise_text(text))

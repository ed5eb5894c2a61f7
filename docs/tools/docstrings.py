"""Docstrings as this project writes them, for the site: ``name : text`` lists become Markdown.

A docstring opens with its first sentence and has sections headed in numpy's way (``Parameters``,
``Raises``, ``Fields``, ``Class attributes``), whose lines are ``name : what it is`` with indented
lines that go on. numpy's own form has a type after the colon, so no parser reads these.
"""

from __future__ import annotations

import re
from typing import Any

import griffe

SECTION = re.compile(r"^(\w[\w ]*)\n-{3,}\n((?:.+\n?)*)", re.MULTILINE)
ITEM = re.compile(r"^(\S[^:\n]*?) ?:(?: |$)(.*(?:\n +.*)*)", re.MULTILINE)


def markdown(text: str) -> str:
    """A docstring as Markdown: each section a heading in bold and a list."""
    return SECTION.sub(_section, text)


def _section(match: re.Match[str]) -> str:
    title, body = match[1], match[2]
    found = list(ITEM.finditer(body))
    if title == "Returns":
        return f"**{title}**\n\n{body}"
    if "\n".join(m[0] for m in found) != body.rstrip():
        raise ValueError(f"a section {title!r} with lines that are no `name : text`:\n{body}")
    items = (f"- {_code(m[1])}: {_joined(m[2])}" for m in found)
    return f"**{title}**\n\n" + "\n".join(items) + "\n"


def _joined(text: str) -> str:
    return " ".join(line.strip() for line in text.strip().splitlines())


def _code(names: str) -> str:
    return ", ".join(f"`{name.strip('` ')}`" for name in names.split(","))


class Docstrings(griffe.Extension):
    """Rewrites every docstring when its object is read."""

    def on_object(self, *, obj: Any, **_: Any) -> None:
        """Modules, classes, functions and attributes alike."""
        if obj.docstring:
            obj.docstring.value = markdown(obj.docstring.value)

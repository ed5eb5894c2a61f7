"""MathML of a saved run as it may stand in a page: elements and attributes of a list, no others."""

from __future__ import annotations

import re
from html import escape
from html.parser import HTMLParser

ELEMENTS = frozenset((
    "mfenced", "mfrac", "mi", "mn", "mo", "mover", "mpadded", "mroot", "mrow", "mspace", "msqrt",
    "mstyle", "msub", "msubsup", "msup", "mtable", "mtd", "mtext", "mtr", "munder", "munderover",
))  # fmt: skip
"""Elements of MathML that only lay out text: none links, embeds, annotates or runs anything."""

ATTRIBUTES = {
    name: re.compile(r"[\w.,()|\[\]{} -]{0,20}")
    for name in ("accent", "close", "displaystyle", "linethickness", "mathvariant", "open",
                 "separators", "stretchy")
}  # fmt: skip
_LONGEST = 200_000  # characters; a term of the largest model here has some 2000


class _Sanitiser(HTMLParser):
    """Copies allowed elements and attributes, all text escaped; remembers which are open."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.parts: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ELEMENTS:
            return
        known = ((k, v or "") for k, v in attrs if k in ATTRIBUTES)
        said = "".join(f' {k}="{escape(v)}"' for k, v in known if ATTRIBUTES[k].fullmatch(v))
        self.parts.append(f"<{tag}{said}>")
        self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        self.handle_endtag(tag)

    def handle_endtag(self, tag: str) -> None:
        if self.open and self.open[-1] == tag:
            self.parts.append(f"</{self.open.pop()}>")

    def handle_data(self, data: str) -> None:
        self.parts.append(escape(data))


def safe_mathml(fragment: object) -> str:
    """A piece of MathML without anything but layout; nothing where it is no text, or too long."""
    if not isinstance(fragment, str) or len(fragment) > _LONGEST:
        return ""
    reader = _Sanitiser()
    reader.feed(fragment)
    reader.close()
    closing = "".join(f"</{tag}>" for tag in reversed(reader.open))
    return "".join(reader.parts) + closing

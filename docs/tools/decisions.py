"""Decisions: an anchor for each number, links between them, and a table of all."""

from __future__ import annotations

import re
from pathlib import Path

PAGES = Path(__file__).parents[1] / "decisions"
DECISION = re.compile(r"^## (\d+)\. (.+)\n\n(\d{4}-\d\d-\d\d)\. (.+)$", re.MULTILINE)
NUMBER = re.compile(r"\b(\d+)\b")


def decisions() -> dict[int, tuple[str, str, str, str]]:
    """Number -> page, title, date and status."""
    found: dict[int, tuple[str, str, str, str]] = {}
    for page in sorted(PAGES.glob("*.md")):
        for number, title, date, status in DECISION.findall(page.read_text(encoding="utf-8")):
            if int(number) in found:
                raise ValueError(f"decision {number} in {found[int(number)][0]} and in {page.name}")
            found[int(number)] = (page.name, title, date, status)
    return found


def with_anchors(text: str) -> str:
    """Each decision at ``#decision-NUMBER``; its date and status in small print, with links."""
    known = decisions()

    def made(match: re.Match[str]) -> str:
        number, title, date, status = match.groups()
        dim = " .superseded" if status.startswith("Superseded") else ""
        head = f"## {number}. {title} {{ #decision-{number}{dim} }}"
        return f"{head}\n\n{date}. {_linked(status, known)}\n{{ .status }}"

    return DECISION.sub(made, text)


def table() -> str:
    """All decisions by number, with their dates and statuses."""
    known = decisions()
    rows = [
        f"| {n} | [{title}]({page}#decision-{n}) | *{date}*{{ .date }} | {_linked(status, known)} |"
        for n, (page, title, date, status) in sorted(known.items())
    ]
    return "\n".join(["| | decision | date | status |", "|--:|---|---|---|", *rows])


def _linked(status: str, known: dict[int, tuple[str, str, str, str]]) -> str:
    """Numbers of decisions in a status, as links."""

    def link(match: re.Match[str]) -> str:
        number = int(match[1])
        return f"[{number}]({known[number][0]}#decision-{number})" if number in known else match[0]

    return NUMBER.sub(link, status)

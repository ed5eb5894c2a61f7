"""What the site takes from elsewhere in the repository, and how its pages are made ready.

README, changelog and the experiments' reports are written once, where readers of the repository
find them, and become pages here. Links between files are those that hold in the repository; they
are turned into the site's, and one to a file that is not there fails the build.
"""

from __future__ import annotations

import html
import re
import sys
from collections.abc import Callable
from pathlib import Path
from posixpath import normpath, relpath
from typing import Any

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

sys.path.insert(0, str(Path(__file__).parent))
from decisions import table, with_anchors
from notebooks import page_of

ROOT = Path(__file__).parents[2]
REPORTS = sorted(p.parent.name for p in (ROOT / "experiments").glob("*/README.md"))
PICTURES = [p.relative_to(ROOT).as_posix() for p in (ROOT / "experiments").glob("*/*.png")]
SITE = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    **{f"experiments/{e}/README.md": f"experiments/{e}.md" for e in REPORTS},
    **{p: p.replace("/", "_").replace("_", "/", 1) for p in PICTURES},
}
"""File of the repository -> file of the site, where it is not the one below ``docs``."""
TAKEN = {site: file for file, site in SITE.items() if file != "README.md"}
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.py"))

FENCE = re.compile(r"^( *)(```+).*?^\1\2 *$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"(!?\[[^\]]*\])\(([^)\s]+)\)")
SECTION = re.compile(r"^<!-- README: (.+) -->$", re.MULTILINE)
MATHS = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)


def on_files(files: Files, config: Any) -> Files:
    """Add the pages and pictures that lie outside ``docs``, and the notebooks with outputs."""
    for site, file in TAKEN.items():
        files.append(File.generated(config, site, abs_src_path=str(ROOT / file)))
    for notebook in NOTEBOOKS:
        text = page_of(notebook, execute=config.extra["execute"])
        files.append(File.generated(config, f"notebooks/{notebook.stem}.md", content=text))
        files.append(File.generated(config, f"notebooks/source/{notebook.name}",
                                    abs_src_path=str(notebook)))  # fmt: skip
    import plotly

    script = Path(plotly.__file__).parent / "package_data" / "plotly.min.js"
    files.append(File.generated(config, "assets/plotly.min.js", abs_src_path=str(script)))
    return files


def on_page_markdown(markdown: str, page: Page, files: Files, **_: Any) -> str:
    """Put sections of the README where a page asks for them, and turn links into the site's."""
    here = page.file.src_uri
    text = _linked(markdown, TAKEN.get(here, f"docs/{here}"), here, files)
    if here.startswith("decisions/"):
        text = with_anchors(text).replace("<!-- decisions -->", table())
    return SECTION.sub(lambda m: _linked(_readme(m[1]), "README.md", here, files), text)


def on_page_content(html: str, **_: Any) -> str:
    """Equations as MathML, which browsers draw without a script or a font."""
    return MATHS.sub(_mathml, html)


def _mathml(match: re.Match[str]) -> str:
    shown = "block" if match[1] == "div" else "inline"
    return convert(html.unescape(match[2]), display=shown)


def _readme(title: str) -> str:
    """A section of the README, without its heading; ``first`` is what stands before any."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    parts = re.split(r"^## (.+)$", text.split("\n", 1)[1], flags=re.MULTILINE)
    sections = {"first": parts[0], **dict(zip(parts[1::2], parts[2::2], strict=True))}
    if title not in sections:
        raise PluginError(f"README without the section {title!r}; it has {', '.join(sections)}")
    return sections[title].strip()


def _linked(text: str, source: str, here: str, files: Files) -> str:
    """Links from ``source`` of the repository, as links from the page ``here``."""

    def link(match: re.Match[str]) -> str:
        label, target = match[1], match[2]
        if re.match(r"[a-z]+:|#", target):
            return match[0]
        path, anchor = re.fullmatch(r"([^#]*)(#.*)?", target).groups("")  # type: ignore[union-attr]
        file = normpath(f"{Path(source).parent.as_posix()}/{path}")
        site = SITE.get(file, file.removeprefix("docs/"))
        if files.get_file_from_path(site) is None:
            raise PluginError(f"{source}: a link to {target}, which is no page or file of the site")
        return f"{label}({relpath(site, Path(here).parent.as_posix())}{anchor})"

    return _outside_code(text, lambda part: LINK.sub(link, part))


def _outside_code(text: str, change: Callable[[str], str]) -> str:
    """Change what stands outside fenced blocks of code."""
    at, pieces = 0, []
    for fence in FENCE.finditer(text):
        pieces += [change(text[at : fence.start()]), fence[0]]
        at = fence.end()
    return "".join([*pieces, change(text[at:])])

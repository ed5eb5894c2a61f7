"""The site: builds strictly, every link leads somewhere, and nothing is fetched from elsewhere."""

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

import spiral

pytest.importorskip("mkdocs", reason="mkdocs is in the dev extra")

ROOT = Path(__file__).parents[2]
LOADS = {"script": "src", "link": "href", "img": "src", "iframe": "src", "source": "src"}


class _Loads(HTMLParser):
    """Addresses of what a browser fetches with a page."""

    def __init__(self, text):
        super().__init__()
        self.found = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        address = given.get(LOADS.get(tag, ""))
        if address and given.get("rel") not in ("prev", "next", "canonical"):
            self.found.append(address)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Built without the notebooks' outputs, which test_notebooks.py makes."""
    folder = tmp_path_factory.mktemp("site")
    environment = {**os.environ, "DOCS_EXECUTE": "false", "NO_MKDOCS_2_WARNING": "1"}
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "WARNING" not in done.stderr
    return folder


def test_pages_load_nothing_from_elsewhere(site):
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 40
    for page in pages:
        away = [a for a in _Loads(page.read_text(encoding="utf-8")).found if "//" in a]
        assert not away, f"{page.relative_to(site)}: {away}"
    for style in site.rglob("*.css"):
        away = re.findall(r"(?:url\(|@import)\s*[\"']?(?:https?:)?//[^)\"']+", style.read_text())
        assert not away, f"{style.relative_to(site)}: {away}"


def test_every_public_name_is_in_the_reference(site):
    pages = {page.stem: page.read_text(encoding="utf-8") for page in (site / "api").glob("*.html")}
    anchors = re.findall(r'id="spiral\.[\w.]+"', "".join(pages.values()))
    known = {anchor.rstrip('"').rsplit(".", 1)[-1] for anchor in anchors}
    assert set(spiral.__all__) - {"plot"} <= known
    assert {"error_falling", "figures"} <= known
    assert "<code>choices</code>: <code>effects</code> beside" in pages["functions"]


def test_decisions_keep_their_numbers(site):
    pages = [p.read_text(encoding="utf-8") for p in (site / "decisions").glob("*.html")]
    found = sorted(int(n) for page in pages for n in re.findall(r'id="decision-(\d+)"', page))
    assert found == list(range(1, max(found) + 1))


def test_equations_are_mathml(site):
    page = (site / "method.html").read_text(encoding="utf-8")
    assert page.count("<math ") > 20
    assert "arithmatex" not in page

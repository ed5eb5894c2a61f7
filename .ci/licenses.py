"""The licence of every package that the program runs with; exit 1 where one is copyleft.

    make licenses

The packages are those that ``spiral-po`` requires, and what they require in turn, as installed
here. Licences are those that they declare (SPDX expression, classifiers, field, in this order).
"""

from __future__ import annotations

import re
import sys
from importlib.metadata import Distribution, PackageNotFoundError, distribution

from packaging.requirements import Requirement

ROOT = "spiral-po"
COPYLEFT = re.compile(r"\b(A?GPL|LGPL|Affero|EUPL|SSPL|(Lesser |Affero )?General Public)", re.I)
BY_FILE = re.compile(r"\bMPL|Mozilla", re.I)
FREE = re.compile(
    r"\bMIT|BSD|Apache|ISC|PSF|Python Software Foundation|Unlicense|Zlib|HPND|CC0"
    r"|Public Domain|NVIDIA|CNRI",
    re.I,
)
READ = {
    "docutils": "Public Domain and BSD (its GPL file, for Emacs, is not in the wheel)",
    "huey": "MIT",
    "skops": "MIT",
}
"""Licences read in the text that the package brings, where what it declares does not say it."""


def required(*needs: str) -> dict[str, Distribution | None]:
    """Every package that these requirements name or need in turn; none where not installed."""
    found: dict[str, Distribution | None] = {}
    waiting = [_named(Requirement(need)) for need in needs]
    seen = set()
    while waiting:
        place = waiting.pop()
        if place in seen:
            continue
        seen.add(place)
        package, extras = place
        try:
            installed = distribution(package)
        except PackageNotFoundError:
            found[package] = None
            continue
        found[package] = installed
        for text in installed.requires or ():
            need = Requirement(text)
            wanted = [{"extra": extra} for extra in extras or ("",)]
            if need.marker is None or any(need.marker.evaluate(w) for w in wanted):
                waiting.append(_named(need))
    return found


def _named(need: Requirement) -> tuple[str, frozenset[str]]:
    """A package's plain name, and the extras of it that are wanted."""
    return re.sub(r"[-_.]+", "-", need.name).lower(), frozenset(need.extras)


def licence(package: Distribution) -> str:
    """What a package says of its licence, in one line."""
    about = package.metadata
    listed = [c.rpartition(" :: ")[2] for c in about.get_all("Classifier") or ()
              if c.startswith("License ::")]  # fmt: skip
    said = about.get("License-Expression") or "; ".join(listed) or about.get("License") or ""
    return (said.strip().splitlines() or [""])[0][:70]


def kind(said: str) -> str:
    """``copyleft``, ``by file`` (changes to its own files are shared), ``free`` or ``unknown``.

    Of several that one may choose from, the freest counts.
    """
    choices = re.split(r"\bOR\b", said)
    kinds = ["copyleft" if COPYLEFT.search(c) else "by file" if BY_FILE.search(c)
             else "free" if FREE.search(c) else "unknown" for c in choices]  # fmt: skip
    return min(kinds, key=("free", "by file", "copyleft", "unknown").index)


def main() -> int:
    """Print a line for each package; the exit code."""
    counts = dict.fromkeys(("free", "by file", "copyleft", "unknown", "not installed"), 0)
    packages = required(ROOT)
    del packages[ROOT]
    for name, package in sorted(packages.items()):
        said = READ.get(name) or (licence(package) if package is not None else "")
        what = "not installed" if package is None else "free" if name in READ else kind(said)
        counts[what] += 1
        version = package.version if package is not None else "-"
        print(f"{name:32} {version:14} {what:14} {said or '-'}")
    print(", ".join(f"{count} {what}" for what, count in counts.items()))
    return int(counts["copyleft"] > 0)


if __name__ == "__main__":
    sys.exit(main())

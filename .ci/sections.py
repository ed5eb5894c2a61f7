"""A lock in two parts: what the program needs, then what tests, checks and documents need.

    python -m pip freeze --all | python .ci/sections.py > requirements.lock

Both parts are of one resolution, that of the environment in which this runs. ``make setup``
installs the first part; ``make test`` and the like the second as well.
"""

from __future__ import annotations

import re
import runpy
import sys
import tomllib
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).parents[1]
HEAD = "# Every version of runtime and dev extra, resolved on Python 3.11. Made by `make lock`."
BUILD = ("pip", "setuptools", "wheel")  # with these the package itself is installed
MARK = "# For tests, checks and documents alone:"


def runtime() -> set[str]:
    """Plain names of all that the program needs, as installed here."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        project = tomllib.load(file)["project"]
    needs = (*project["dependencies"], *project["optional-dependencies"]["formats"], *BUILD)
    return set(runpy.run_path(str(ROOT / ".ci" / "licenses.py"))["required"](*needs))


def parted(pins: Iterable[str], first: set[str]) -> str:
    """The pins ``NAME==VERSION`` in two parts, without the marks of local builds."""
    parts: tuple[list[str], list[str]] = ([], [])
    for pin in pins:
        name = re.sub(r"[-_.]+", "-", pin.partition("==")[0]).lower()
        parts[name not in first].append(pin.strip().removesuffix("+cpu"))
    return "\n".join([HEAD, *parts[0], MARK, *parts[1], ""])


if __name__ == "__main__":
    print(parted((line for line in sys.stdin if "==" in line), runtime()), end="")

"""The locked versions with the SHA-256 of their wheels, for ``pip install --require-hashes``.

    python .ci/hashes.py requirements.lock > requirements.hashes.lock

Hashes are those of the wheels that pip would install here: this system, this Python. Where the
index at hand serves another build than the public one (as ``2.13.0+cpu``), a comment says so.
"""

from __future__ import annotations

import json
import re
import runpy
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

MARK = runpy.run_path(str(Path(__file__).with_name("sections.py")))["MARK"]


def report(lock: str) -> list[tuple[str, str, str]]:
    """Name, address and SHA-256 of what pip would install; nothing is installed."""
    options = ["--no-deps", "--ignore-installed", "--dry-run", "-qq", "--report", "-"]
    done = subprocess.run(
        [sys.executable, "-m", "pip", "install", *options, "--requirement", lock],
        check=True, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    return [
        (item["metadata"]["name"], unquote(item["download_info"]["url"]),
         item["download_info"]["archive_info"]["hashes"]["sha256"])
        for item in json.loads(done.stdout)["install"]
    ]  # fmt: skip


def main(lock: str) -> None:
    """Print the lock with hashes."""
    text = Path(lock).read_text(encoding="utf-8")
    first, mark, _ = text.partition(MARK)
    lines = [x for x in text.splitlines() if "==" in x]
    pinned = {re.sub(r"[-_.]+", "-", x.partition("==")[0]).lower(): x for x in lines}
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    print(f"# {lock} with hashes, for Linux on x86_64 and Python {version}. Made by `make lock`.")
    wheels = [(pinned[re.sub(r"[-_.]+", "-", name).lower()], *more) for name, *more in report(lock)]
    for later in (False, True):
        if later:
            print(mark)
        part = [w for w in wheels if (w[0] not in first.splitlines()) is later]
        _print(sorted(part, key=lambda wheel: wheel[0].lower()))


def _print(wheels: list[tuple[str, ...]]) -> None:
    """An entry for each wheel: its pin, its hash, and a word where the public index has another."""
    for line, address, found in wheels:
        wheel = address.rpartition("/")[2]
        if "+" in wheel:
            print(f"# {wheel}: not the build of the public index")
        print(f"{line} \\\n    --hash=sha256:{found}")


if __name__ == "__main__":
    main(sys.argv[1])

"""The locked versions with the SHA-256 of their wheels, for ``pip install --require-hashes``.

    python .ci/hashes.py requirements.lock > requirements.hashes.lock

Hashes are those of the wheels that pip would install here: this system, this Python. Where the
index at hand serves a build of its own (a version such as ``2.13.0+cpu``), the public one is added.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import unquote

PLAIN = {**{k: v for k, v in os.environ.items() if not k.startswith("PIP_")},
         "PIP_CONFIG_FILE": os.devnull}  # fmt: skip
"""An environment in which pip asks the public index."""


def report(wanted: list[str], environment: Mapping[str, str]) -> list[tuple[str, str, str]]:
    """Name, address and SHA-256 of what pip would install; nothing is installed."""
    options = ["--no-deps", "--ignore-installed", "--dry-run", "-qq", "--report", "-"]
    done = subprocess.run(
        [sys.executable, "-m", "pip", "install", *options, *wanted],
        check=True, stdout=subprocess.PIPE, text=True, env=environment,
    )  # fmt: skip
    return [
        (item["metadata"]["name"], unquote(item["download_info"]["url"]),
         item["download_info"]["archive_info"]["hashes"]["sha256"])
        for item in json.loads(done.stdout)["install"]
    ]  # fmt: skip


def main(lock: str) -> None:
    """Print the lock with hashes."""
    lines = [x for x in Path(lock).read_text(encoding="utf-8").splitlines() if "==" in x]
    pinned = {re.sub(r"[-_.]+", "-", x.partition("==")[0]).lower(): x for x in lines}
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    print(f"# {lock} with hashes, for Linux on x86_64 and Python {version}. Made by `make lock`.")
    for name, address, found in sorted(
        report(["--requirement", lock], os.environ), key=lambda i: i[0].lower()
    ):
        line = pinned[re.sub(r"[-_.]+", "-", name).lower()]
        hashes = [found]
        if "+" in address.rpartition("/")[2]:
            print(f"# {line}: {address.rpartition('/')[2]}, then the public build")
            hashes += [other for *_, other in report([line], PLAIN)]
        print(" \\\n    ".join([line, *(f"--hash=sha256:{one}" for one in hashes)]))


if __name__ == "__main__":
    main(sys.argv[1])

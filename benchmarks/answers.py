"""Whether a change of the code changed an answer: the JSON of many commands, kept and compared.

    python benchmarks/answers.py keep FOLDER                 # run every command, write its JSON
    python benchmarks/answers.py compare BEFORE AFTER        # numbers to 1e-6 relative, texts equal

``keep`` runs in a checkout of the code before (``git worktree add``) and in the one after. What is
already in the folder stays, so a run that was cut off goes on. Presets on measured data need
``SPIRAL_DATA``; where a set is absent its command is left out and named.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

SIMULATED = (
    "rotor_coastdown", "rotor_coastdown_settled", "rotor_coastdown_text", "rotor_nothing_hidden",
    "rotor_one_bearing", "rotor_soft_tilt",
)  # fmt: skip
MEASURED = ("cascaded_tanks", "multiarm_pendulum", "rk4_rotor_runup", "silverbox")
ROTOR = "experiment=rotor_coastdown"
OTHER_VERBS = ("compare", "diagnose", "estimate", "identify", "plan cross_stiffness axis_rotation")
PASSING = {"seconds", "run_id", "created", "context", "out"}
"""Keys whose values differ between any two runs."""
RELATIVE = 1e-6


def commands() -> dict[str, list[str]]:
    """Every command under the name of its answer's file."""
    found = {}
    for preset in SIMULATED:
        for seed in ("", "101", "102"):
            words = ["discover", f"experiment={preset}", *([f"record.seed={seed}"] if seed else [])]
            found[f"discover-{preset}{'-' + seed if seed else ''}"] = words
    for preset in MEASURED:
        found[f"discover-{preset}"] = ["discover", f"experiment={preset}"]
    for strategy in ("paper", "innovation"):
        found[f"discover-{strategy}"] = ["discover", ROTOR, f"strategy={strategy}"]
    for verb in OTHER_VERBS:
        found[verb.split()[0]] = [*verb.split(), ROTOR]
    return found


def keep(folder: Path, only: str) -> None:
    """Run every command that has no answer yet, and write it."""
    folder.mkdir(parents=True, exist_ok=True)
    spiral = Path(sys.executable).with_name("spiral")
    for name, words in commands().items():
        file = folder / f"{name}.json"
        if file.exists() or only not in name:
            continue
        clock = time.perf_counter()
        made = subprocess.run(
            [spiral, *words, f"out={folder / 'runs'}", "--json", str(file)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        told = f"exit {made.returncode}, {time.perf_counter() - clock:.0f} s"
        if not file.exists():
            told += f": no answer: {made.stderr.strip()[-300:]}"
        print(f"{name}: {told}", flush=True)


def differences(before: Any, after: Any, place: str = "") -> Iterator[str]:
    """Where two answers differ: a number by more than 1e-6 relative, anything else at all."""
    if isinstance(before, dict) and isinstance(after, dict):
        for key in sorted(set(before) | set(after), key=str):
            if key in PASSING:
                continue
            if key not in before or key not in after:
                yield f"{place}.{key}: only {'after' if key in after else 'before'}"
                continue
            yield from differences(before[key], after[key], f"{place}.{key}")
    elif isinstance(before, list) and isinstance(after, list):
        if len(before) != len(after):
            yield f"{place}: {len(before)} entries -> {len(after)}"
        for i, (a, b) in enumerate(zip(before, after, strict=False)):
            yield from differences(a, b, f"{place}[{i}]")
    elif _number(before) and _number(after):
        if not math.isclose(before, after, rel_tol=RELATIVE, abs_tol=1e-300):
            share = abs(after - before) / max(abs(before), abs(after))
            yield f"{place}: {before!r} -> {after!r} ({share:.1e})"
    elif before != after:
        yield f"{place}: {before!r} -> {after!r}"


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def compare(before: Path, after: Path) -> int:
    """Print every difference; 1 where there is one."""
    files = sorted({p.name for p in (*before.glob("*.json"), *after.glob("*.json"))})
    changed = 0
    for name in files:
        if not ((before / name).exists() and (after / name).exists()):
            print(f"{name}: only {'after' if (after / name).exists() else 'before'}")
            changed += 1
            continue
        pair = [json.loads((place / name).read_text()) for place in (before, after)]
        found = list(differences(*pair))
        changed += bool(found)
        print(f"{name}: {'the same' if not found else f'{len(found)} differences'}")
        for line in found[:20]:
            print(f"    {line}")
    print(f"{len(files) - changed} of {len(files)} answers are the same")
    return int(changed > 0)


def main() -> int:
    """Keep or compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parts = parser.add_subparsers(dest="verb", required=True)
    keeper = parts.add_parser("keep")
    keeper.add_argument("folder", type=Path)
    keeper.add_argument("--only", default="", help="names that hold this text")
    judge = parts.add_parser("compare")
    judge.add_argument("before", type=Path)
    judge.add_argument("after", type=Path)
    given = parser.parse_args()
    if given.verb == "keep":
        keep(given.folder, given.only)
        return 0
    return compare(given.before, given.after)


if __name__ == "__main__":
    sys.exit(main())

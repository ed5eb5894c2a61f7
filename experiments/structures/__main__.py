"""Structures of more than 10 000 degrees of freedom with something hidden at an unknown place.

python -m experiments.structures run [--half tune] [--seeds 1] [--systems beam,rotor] [--cases 0,1]
    [--limit 600] [--jobs 1]
python -m experiments.structures score [--half all] [--details] [--markdown FILE]

Rows are kept as they end (runs/structures/rows.jsonl); the same command takes up what is there.
"""

from __future__ import annotations

import sys

from experiments.structures.bench import BENCH
from experiments.studies.command import main

if __name__ == "__main__":
    words = sys.argv[1:]
    once = ["--seeds", "1"] if words[:1] == ["run"] and "--seeds" not in words else []
    main(BENCH, __doc__ or "", [*words, *once])

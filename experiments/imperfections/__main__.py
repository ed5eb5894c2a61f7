"""Imperfections of records, and what they do to names, errors and intervals.

python -m experiments.imperfections run [--half tune] [--seeds 3] [--systems oscillator,rotor]
    [--cases white,"white null",..] [--strategy NAME] [--limit 300] [--jobs 1]
python -m experiments.imperfections score [--half all] [--details] [--markdown FILE]

Rows are kept as they end (runs/imperfections/rows.jsonl); the same command takes up what is there.
"""

from __future__ import annotations

from experiments.imperfections.bench import BENCH
from experiments.studies.command import main

if __name__ == "__main__":
    main(BENCH, __doc__ or "")

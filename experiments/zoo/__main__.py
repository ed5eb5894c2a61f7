"""The zoo: machines and measured records that nobody tuned for.

python -m experiments.zoo run [--half tune] [--seeds 3] [--systems NAME,..] [--cases NAME,..]
    [--strategy NAME] [--limit 300] [--jobs 1]
python -m experiments.zoo score [--half all] [--details] [--markdown FILE]

Rows are kept as they end (runs/zoo/rows.jsonl); the same command takes up what is there.
"""

from __future__ import annotations

from experiments.studies.command import main
from experiments.zoo.bench import BENCH

if __name__ == "__main__":
    main(BENCH, __doc__ or "")

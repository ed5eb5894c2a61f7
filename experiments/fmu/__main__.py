"""Ten FMUs with something hidden: which effect is named first, and what an FMU costs.

python -m experiments.fmu [--only drive]
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

import spiral
from experiments.fmu.build import fmu, native, system
from experiments.fmu.kinds import CASES, KINDS, Case, Kind
from experiments.studies.signals import band_limited
from spiral.types.record import Record
from spiral.types.run import Run
from spiral.types.system import System

NOISE = 0.01
WRONG = (0.85, 1.15)  # first values of what is to be found, of the truth


def record(case: Case, kind: Kind, seed: int = 0) -> Record:
    """The machine with what is hidden, simulated from its equations."""
    rms, band = kind.drive
    duration = kind.samples / kind.rate
    signal = band_limited(np.random.default_rng([seed, 1]), rms, band, duration)
    at = np.arange(kind.samples) / kind.rate
    values = {f"{case.effect}.{k}": v for k, v in case.values.items()}
    return spiral.simulate(
        native(kind), duration, kind.rate, inputs={kind.input[0]: signal(at)},
        effects=[case.effect], values=values, noise_level=NOISE, seed=seed,
    )  # fmt: skip


def asked(data: Record, machine: System, kind: Kind) -> tuple[Run, float]:
    """What a study answers, and its seconds of processor time; first values are wrong."""
    names = list(machine.defaults)
    truth = [kind.parameters[n][0] for n in kind.free]
    first = {k: v * w for k, v, w in zip(names, truth, WRONG, strict=True)}
    before = time.process_time()
    run = spiral.discover(data, machine, values=first)
    return run, time.process_time() - before


def _short(label: str, kind: Kind) -> str:
    """An effect at the first place is told without its port."""
    return label.removesuffix(f"@{kind.coordinates[0]}")


def study(case: Case, folder: Path) -> dict[str, object]:
    """One row: the case with its FMU and with its equations."""
    kind = KINDS[case.kind]
    data = record(case, kind)
    by_fmu, seconds = asked(data, system(case, kind, fmu(case, kind, folder)), kind)
    by_hand, own = asked(data, native(kind), kind)
    names = tuple(x for r in by_fmu.rounds for x in r.admitted)
    first = names[:1] in ((case.effect,), (_short(case.effect, kind),))
    return {"case": case.name, "hidden": case.effect, "named": ", ".join(names) or "nothing",
            "first": first, "equations": ", ".join(x for r in by_hand.rounds for x in r.admitted),
            "seconds": seconds, "of equations": own}  # fmt: skip


def main() -> None:
    """Run and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=())
    wanted = parser.parse_args().only
    cases = [c for c in CASES if not wanted or c.kind in wanted]
    right, ratios = 0, []
    print("| machine, FMU | hidden | named | with equations | s | of equations | ratio |")
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as place:
        for case in cases:
            row = study(case, Path(place))
            right += bool(row["first"])
            seconds, own = float(str(row["seconds"])), float(str(row["of equations"]))
            ratios.append(seconds / own)
            print(f"| {row['case']} | `{row['hidden']}` | {row['named']} | {row['equations']} | "
                  f"{seconds:.1f} | {own:.1f} | {ratios[-1]:.2f} |", flush=True)  # fmt: skip
    print(f"\nright effect first: {right} of {len(cases)}; cost over equations: median "
          f"{np.median(ratios):.2f}, largest {max(ratios):.2f}")  # fmt: skip


if __name__ == "__main__":
    main()

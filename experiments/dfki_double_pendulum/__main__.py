"""DFKI's measured double pendulum from a robot's description to friction in its joints.

python -m experiments.dfki_double_pendulum            # what is missing?
python -m experiments.dfki_double_pendulum --added    # friction in both joints added

The data lie below SPIRAL_DATA; MuJoCo (the extra robots) reads the description.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

import spiral

AUTHORS = {"coulomb_friction.level": 0.093, "coulomb_friction@elbow.level": 0.078}
"""N m, of identified_A0_model_2.0.yml."""
READ = {
    "time": "time",
    "resample": 250,
    "channels": {"shoulder": "pos_meas1", "elbow": "pos_meas2"},
    "inputs": {"shoulder_torque": "tau_meas1", "elbow_torque": "tau_meas2"},
}
FREE = ["upper_inertia", "lower_inertia", "shoulder_damping", "elbow_damping"]


def main() -> None:
    """Discover, or add friction, and print it beside the authors'."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--added", action="store_true", help="add friction in both joints")
    given = parser.parse_args()
    folder = os.environ.get("SPIRAL_DATA", "")
    place = Path(folder, "dfki_double_pendulum")
    if not folder or not place.is_dir():
        raise SystemExit(f"no data in {place}: set SPIRAL_DATA")
    arm = spiral.system(
        Path(__file__).with_name("arm.xml"), inputs=["shoulder", "elbow"], free=FREE
    )
    files = {n: str(place / f"A0_20220815_{n}.csv") for n in ("00", "12", "01")}
    records = spiral.read([files["00"], files["12"]], arm, **READ)
    test = spiral.read(files["01"], arm, **READ)
    clock = time.process_time()
    if given.added:
        labels = [name.rsplit(".", 1)[0] for name in AUTHORS]
        found = spiral.compare(records, arm, effects=labels, test=test)
        print(f"fit error {found.fit_error:.3f}, test error {found.test_error:.3f}", found.random)
    else:
        found = spiral.discover(records, arm, test=test)
        for suggestion in found.rounds[0].suggestions[:5]:
            print("suggested:", suggestion.effect, suggestion.statistic, suggestion.aliases)
        print(found)
    for owner, table in found.model.estimates().items():
        for name, value in table.items():
            print(f"{owner}.{name}: {value.estimate:.4g} +- {value.se} {value.unit}")
    print("authors:", AUTHORS)
    print(f"{time.process_time() - clock:.0f} s of processor time")


if __name__ == "__main__":
    main()

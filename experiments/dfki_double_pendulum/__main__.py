"""DFKI's measured double pendulum from a robot's description to friction in its joints.

python -m experiments.dfki_double_pendulum        # the data below SPIRAL_DATA, MuJoCo (extra robots)
"""

from __future__ import annotations

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
    "hold": "zero_order",
}
FREE = ["upper_inertia", "lower_inertia", "shoulder_damping", "elbow_damping"]


def main() -> None:
    """Fit, discover, and print friction beside the authors'."""
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
    run = spiral.discover(records, arm, test=test)
    print(run, run.estimates().to_string(), sep="\n")
    for suggestion in run.rounds[0].suggestions[:5]:
        print("suggested:", suggestion.effect, suggestion.statistic, suggestion.aliases)
    for name, value in AUTHORS.items():
        print(f"{name}: {run.model.values.get(name)} (authors {value})")
    print(f"{time.process_time() - clock:.0f} s of processor time")


if __name__ == "__main__":
    main()

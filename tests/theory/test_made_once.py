"""What a study makes of a file is made once: noise, arrays, compiled models, free runs."""

from collections import Counter

import numpy as np
import pandas as pd
import pytest

import spiral
from spiral.engine import series
from spiral.inference.likelihood import free_run_starts
from spiral.physics import compile as compiling
from spiral.types import record as records


@pytest.fixture
def counts(monkeypatch):
    """How often each of these was made, by what it was made of."""
    made = {name: Counter() for name in ("noise", "arrays", "models", "free runs")}

    def counted(module, name, what, key):
        function = getattr(module, name)

        def around(*args, **kwargs):
            made[what][key(*args)] += 1
            return function(*args, **kwargs)

        monkeypatch.setattr(module, name, around)

    counted(records, "estimate_noise", "noise", lambda values: values.tobytes())
    counted(
        series, "_build_series", "arrays", lambda _, r, steps, __: (r.samples, str(r.hold), steps)
    )
    counted(compiling, "write_function", "models", lambda _, name, model, *__: (name, model.keys))
    counted(free_run_starts, "free_run_from_stage", "free runs", lambda a, stage, settled: (
        tuple(stage.fitted.point.values.ravel()), settled, len(a.study.series[0].y)))  # fmt: skip
    return made


def test_of_a_file_with_one_effect_missing_nothing_is_made_twice(counts, tmp_path):
    """3000 rows, one admission: two records (the last fifth is the test) at two step widths."""
    machine = spiral.simulate(
        "oscillator", duration=6.0, rate=500.0, inputs={"force": {"noise": 1.0, "band": [2, 40]}},
        effects=["cubic_stiffness"], noise_level=0.02, seed=3,
        values={"system.mass": 1.2, "linear_stiffness.stiffness": 4e3,
                "linear_damping.damping": 6.0, "cubic_stiffness.stiffness": 2e9},
    )  # fmt: skip
    table = {"t": machine.time, "q": machine.channels["x"], "f": machine.inputs["force"]}
    pd.DataFrame(table).to_csv(tmp_path / "bench.csv", index=False)
    for counter in counts.values():
        counter.clear()
    columns = {"channels": {"x": "q"}, "inputs": {"force": "f"}}
    record = spiral.read(tmp_path / "bench.csv", "oscillator", time="t", **columns)
    run = spiral.discover(record, "oscillator")
    assert run.missing == ("cubic_stiffness",)
    assert len(counts["noise"]) == 2
    assert set(counts["noise"].values()) == {1}
    assert set(counts["models"].values()) == {1}
    assert max(counts["free runs"].values()) == 1
    whole = [n for (samples, *_), n in counts["arrays"].items() if samples in (2400, 600)]
    assert set(whole) == {1}  # the others are the head of the test record, looked at by each model
    assert np.isfinite(run.final.test_error)

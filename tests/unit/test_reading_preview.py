"""What reading makes of a file's numbers, before and after."""

import numpy as np
from spiral_plugins.sources.file import File
from spiral_plugins.systems.oscillator import Oscillator

from spiral.io.readers.as_written import altered_series_names, alters_numbers, unprocessed_series
from spiral.view.report.reading import reading_figure

UNITS = {"x": "m", "force": "N"}


def written(folder, gap=()):
    """A file in mm, two of whose readings may be missing."""
    time = np.arange(400) / 100
    x = 1e3 * (0.01 + 0.002 * np.sin(2 * np.pi * time))
    rows = [f"{t:.9g},{'' if i in gap else f'{v:.15g}'},{np.cos(t):.9g}"
            for i, (t, v) in enumerate(zip(time, x, strict=True))]  # fmt: skip
    file = folder / "run.csv"
    file.write_text("\n".join(["t,x,force", *rows]) + "\n")
    return str(file), time, 1e-3 * x


def test_numbers_as_written_are_in_the_systems_units_with_their_gaps_and_offsets(tmp_path):
    path, time, x = written(tmp_path, gap=(100, 101))
    source = File(path=path, units={"x": "mm"}, offset={"x": 10.0}, fill_gaps=2)
    before, record = unprocessed_series(source, Oscillator()), source.load(Oscillator())[0]
    np.testing.assert_allclose(before.time, time)
    known = np.isfinite(before.channels["x"])
    assert list(np.flatnonzero(~known)) == [100, 101]
    np.testing.assert_allclose(before.channels["x"][known], x[known], atol=1e-11)
    np.testing.assert_allclose(record.channels["x"][known], (x - 0.01)[known], atol=1e-11)
    assert altered_series_names(before, record) == ["x"]


def test_what_no_setting_changes_is_not_told(tmp_path):
    path, *_ = written(tmp_path)
    assert not alters_numbers(File(path=path, units={"x": "mm"}))
    source = File(path=path, units={"x": "mm"}, fill_gaps=2)
    before, record = unprocessed_series(source, Oscillator()), source.load(Oscillator())[0]
    assert alters_numbers(source)
    assert altered_series_names(before, record) == []


def test_the_closer_look_is_at_the_gap_and_shows_single_samples(tmp_path):
    path, time, _ = written(tmp_path, gap=(100, 101))
    source = File(path=path, units={"x": "mm"}, fill_gaps=2, resample=50.0)
    before, record = unprocessed_series(source, Oscillator()), source.load(Oscillator())[0]
    names = altered_series_names(before, record)
    assert names == ["x", "force"]
    figure = reading_figure(before, record, names, UNITS)
    close = [t for t in figure.data if t.xaxis == "x2"]
    assert [t.mode for t in close] == ["lines+markers"] * 2
    assert close[0].x[0] < time[100] < close[0].x[-1]
    assert len(close[0].x) <= 41

"""Moments and times of day in text become seconds, and what is ambiguous is not guessed."""

import numpy as np
import pandas as pd
import pytest

from spiral.io.readers.moments import seconds_of
from spiral.io.registry import load_registry
from spiral.types.errors import InputError

REGISTRY = load_registry()
OSCILLATOR = REGISTRY.make("system", "oscillator")
COUNT = 100
MOMENTS = pd.Timestamp("2026-02-28T23:59:58") + pd.to_timedelta(0.1 * np.arange(COUNT), unit="s")
WRITTEN = ("%Y-%m-%dT%H:%M:%S.%f", "%Y-%m-%d %H:%M:%S.%f+01:00", "%d.%m.%Y %H:%M:%S.%f",
           "%m/%d/%Y %H:%M:%S.%f", "%m/%d/%Y %I:%M:%S.%f %p", "%H:%M:%S.%f")  # fmt: skip


def seconds(*cells):
    return seconds_of(pd.Series(cells, dtype=str))


@pytest.mark.parametrize("written", WRITTEN)
def test_what_a_logger_writes_is_its_time_also_past_midnight_and_the_month(tmp_path, written):
    file = tmp_path / "log.csv"
    values = np.arange(COUNT) ** 2
    table = {"time": MOMENTS.strftime(written), "x": values, "force": values}
    pd.DataFrame(table).to_csv(file, index=False)
    record = REGISTRY.make("source", "file", {"path": str(file)}, "record").load(OSCILLATOR)[0]
    assert record.dt == pytest.approx(0.1)
    assert record.samples == COUNT


def test_a_zone_counts_and_an_empty_cell_is_none():
    np.testing.assert_allclose(
        seconds("2026-03-29T01:59:59+01:00", "", "2026-03-29T03:00:01+02:00"), [0, np.nan, 2]
    )
    np.testing.assert_allclose(seconds("10:00", "10:01:30,5"), [0, 90.5])


@pytest.mark.parametrize(
    "cells",
    [("11/12/2026 23:00:00", "12/12/2026 00:00:00"), ("2026-13-45T00:00", "2026-13-46T00:00"),
     ("10:00", "noon"), ("start", "end"), ("", "")],
)  # fmt: skip
def test_what_is_no_moment_or_two_is_not_guessed(cells):
    assert seconds(*cells) is None


def test_of_one_day_the_order_of_its_date_does_not_matter():
    np.testing.assert_allclose(seconds("11/12/2026 23:00:00", "11/12/2026 23:00:01"), [0, 1])


def test_a_column_of_time_that_cannot_be_read_is_told_how(tmp_path):
    file = tmp_path / "log.csv"
    pd.DataFrame({"time": ["a", "b", "c"], "x": [1, 2, 3], "force": 0}).to_csv(file, index=False)
    with pytest.raises(InputError, match="2026-11-30T04:13:40"):
        REGISTRY.make("source", "file", {"path": str(file)}, "record").load(OSCILLATOR)

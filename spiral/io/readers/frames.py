"""A table of what is in memory: a DataFrame, or arrays by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from spiral.io.readers.dialect import units_in_names
from spiral.io.readers.table import Table
from spiral.types.errors import ConfigError, InputError

NAME = "data"
"""What messages call a table that has no file."""


def is_frame(given: Any) -> bool:
    """Whether this is a table, or series by name; a mapping with a ``name`` is a source."""
    if isinstance(given, Mapping):
        return not isinstance(given.get("name"), str)
    return hasattr(given, "columns") and hasattr(given, "__getitem__")


def table_of(given: Any, decimal: str = ".") -> Table:
    """The columns of a DataFrame, its index too where it is no count of rows; or of a mapping.

    ``decimal`` : the decimal mark of columns of text. Tables of other libraries become a DataFrame.

    Raises
    ------
    InputError : a column that is no series.
    """
    if isinstance(given, Mapping):
        columns = dict(given)
    else:
        given = given.to_pandas() if hasattr(given, "to_pandas") else given
        columns = {str(name): given[name] for name in given.columns}
        index = getattr(given, "index", None)
        if index is not None and not _counts_rows(index):
            columns.setdefault(str(index.name or "index"), index.to_series().reset_index(drop=True))
    for name, values in columns.items():
        if np.ndim(values) != 1:
            raise InputError(
                f"column {name!r} of shape {np.shape(values)}", "a series of numbers, (samples,)",
                "one name for each series; rows become a table by pandas.DataFrame(rows)",
            )  # fmt: skip
    series = {str(k): _plain_series(v) for k, v in columns.items()}
    return Table(NAME, series, units_in_names(series), decimal=decimal)


def refuse_array(given: Any) -> None:
    """Refuse an array or a single series: there are no names in it."""
    if isinstance(given, np.ndarray) or (hasattr(given, "to_numpy") and not is_frame(given)):
        raise ConfigError(
            f"an array of shape {np.shape(given)}",
            "a file, a DataFrame, or series by name",
            "spiral.read({'t': a[:, 0], 'x': a[:, 1]}, system, time='t')",
        )


def _counts_rows(index: Any) -> bool:
    return index.name is None and np.array_equal(np.asarray(index), np.arange(len(index)))


def _plain_series(values: Any) -> Any:
    """As the reader of tables takes it: numbers, seconds, moments or text, rows from zero."""
    import pandas as pd

    if isinstance(values, np.ma.MaskedArray):
        return np.ma.filled(values.astype(float), np.nan)
    series = pd.Series(np.asarray(values) if isinstance(values, np.ndarray) else list(values))
    if isinstance(series.dtype, pd.DatetimeTZDtype):
        return series.dt.tz_convert(None).to_numpy()
    if pd.api.types.is_timedelta64_dtype(series):
        return series.dt.total_seconds().to_numpy()
    plain = series.infer_objects().to_numpy()
    return plain.astype(str) if plain.dtype == object else plain

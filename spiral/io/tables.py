"""Records and reconstructed states written as tables: CSV or Parquet."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spiral.types.errors import ConfigError, InputError, SpiralError, did_you_mean

if TYPE_CHECKING:
    import pandas as pd

    from spiral.inference.reconstruction.estimate import RecordReconstruction
    from spiral.types.record import Record
    from spiral.types.system import System

_SUFFIXES = (".csv", ".parquet")


@dataclass(frozen=True)
class WrittenTable:
    """A file that was written: its units by column, and the overrides that read it back."""

    file: str
    rows: int
    units: dict[str, str]
    read_back: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """As JSON."""
        return {"file": self.file, "rows": self.rows, "units": self.units}


def write_record(
    record: Record, system: System, file: str, number: int | None = None
) -> WrittenTable:
    """Time, channels and inputs of a record as columns, in the system's units.

    Parameters
    ----------
    number : added to the file's name where one source gives several records.

    Raises
    ------
    ConfigError : an unknown ending. InputError : a file that cannot be written.
    """
    import pandas as pd

    path = _output_path(file, number)
    measured = {k: v for k, v in record.inputs.items() if k in record.measured}
    frame = pd.DataFrame({"time": record.time, **record.channels, **measured})
    _write_frame(frame, path)
    units = {"time": "s", **{k: system.unit_of(k) for k in (*record.channels, *measured)}}
    return WrittenTable(
        str(path), len(frame), units, _read_back_overrides(record, system, str(path), measured)
    )


def write_states(
    part: RecordReconstruction, file: str, number: int | None = None
) -> tuple[WrittenTable, ...]:
    """Write the series of a reconstruction (``RecordReconstruction.series``).

    A file without an ending is written twice, as CSV and as Parquet.

    Raises
    ------
    ConfigError : an unknown ending. InputError : a file that cannot be written.
    """
    given = Path(file).expanduser()
    targets = [f"{given}{s}" for s in _SUFFIXES] if not given.suffix else [file]
    frame = part.series()
    units = {"time": "s", **{n: part.unit(n) for n in part.reconstruction.names if n in frame}}
    written = []
    for target in targets:
        path = _output_path(target, number)
        _write_frame(frame, path)
        written.append(WrittenTable(str(path), len(frame), units, ()))
    return tuple(written)


def _output_path(file: str, number: int | None) -> Path:
    path = Path(file).expanduser()
    if path.suffix not in _SUFFIXES:
        raise ConfigError(
            f"--out {file}", "a file that ends in .csv or .parquet",
            did_you_mean(path.suffix, _SUFFIXES),
        )  # fmt: skip
    return path if number is None else path.with_stem(f"{path.stem}_{number}")


def _write_frame(frame: pd.DataFrame, path: Path) -> None:
    try:
        if path.suffix == ".csv":
            frame.to_csv(path, index=False)
        else:
            frame.to_parquet(path, index=False)
    except OSError as error:
        text = f"--out {path}: {error.strerror or error}"
        raise InputError(text, "a file that can be written") from error


def _own_fields(system: System) -> dict[str, Any]:
    """The fields that tell a system from the usual one of its class; none that follows from others.

    As the text of a system's file follows from the file's path.
    """
    from spiral.types.fields import defaults_of, plain

    usual = defaults_of(type(system))
    own = {k: v for k, v in plain(system).items() if k != "name" and v != usual[k]}
    for name in list(own):
        rest = {k: getattr(system, k) for k in own if k != name}
        try:
            follows = bool(rest) and type(system)(**rest) == system
        except SpiralError:
            follows = False
        if follows:
            own.pop(name)
    return own


def _read_back_overrides(
    record: Record, system: System, file: str, measured: dict[str, Any]
) -> tuple[str, ...]:
    own, name = _own_fields(system), system.plugin_name()
    channels = ", ".join(f"{c}: {c}" for c in record.channels)
    inputs = ", ".join(f"{i}: {i}" for i in measured)
    noise = ", ".join(f"{c}: {s:.6g}" for c, s in record.noise.items())
    return (
        f"system={name}",
        *(f"system.{k}={v}" for k, v in own.items()),
        "record=csv",
        f"record.path={file}",
        "record.time=time",
        f"record.channels={{{channels}}}",
        *([f"record.inputs={{{inputs}}}"] if inputs else []),
        *([f"record.noise={{{noise}}}"] if noise else []),
    )

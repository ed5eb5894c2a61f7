"""Files that declare much, or whose form costs much: under the real limits, in time and memory.

make test-slow PYTEST=tests/safety/test_hostile_files.py: also those just below what is refused.
"""

import struct

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io

from spiral.io.readers import containers
from spiral.io.readers.formats import read_table
from spiral.io.readers.limits import within_seconds
from spiral.io.readers.matrices import read_matrices
from spiral.types.errors import InputError, SpiralError
from tests.safety.conftest import flood

h5py = pytest.importorskip("h5py")
ROWS = "1,2\n" * 100


def text(content):
    return lambda file: file.write_text(content())


def tdms(count, raw, *index):
    """A TDMS file with one channel that declares so many values, and more segments like it."""

    def word(name):
        return struct.pack("<I", len(name)) + name

    nothing = struct.pack("<II", 0xFFFFFFFF, 0)
    values = struct.pack("<IIIQ", 20, 10, 1, count) if not index else struct.pack(*index)
    meta = struct.pack("<I", 3) + word(b"/") + nothing + word(b"/'g'") + nothing
    meta += word(b"/'g'/'c'") + values + struct.pack("<I", 0)
    head = struct.pack("<IIQQ", 14, 4713, len(meta) + len(raw), len(meta))
    return b"TDSm" + head + meta + raw


def segments(file):
    again = b"TDSm" + struct.pack("<IIQQ", 8, 4713, 8, 0) + bytes(8)
    file.write_bytes(tdms(1, bytes(8)) + 20_000 * again)


def uff(count, lines):
    head = ["    -1", "    58", "x", "NONE", "now", "NONE", "NONE"]
    head += ["    1         1    1         0       NONE         1   3       NONE         0   0"]
    head += [f"{4:10}{count:10}{1:10}{0.0:13.5e}{1e-3:13.5e}{0.0:13.5e}"]
    head += [4 * [f"{17:10}    0    0    0                 Time                    s"]][0]
    return "\n".join([*head, *lines, "    -1", ""])


def hdf5(add):
    def make(file):
        with h5py.File(file, "w") as target:
            target["good"] = np.arange(100.0)
            add(target)

    return make


def many_names(file):
    for i in range(100):
        file[f"{i}" + "n" * 60_000] = np.arange(10.0)


def long_unit(file):
    file["good"].attrs["units"] = "m" * 60_000


def old_matlab(kind, rows, columns, content=bytes(800)):
    """Version 4: of this class (0 numbers, 2 sparse), declaring so many rows and columns."""
    return lambda f: f.write_bytes(struct.pack("<5i", kind, rows, columns, 0, 2) + b"x\0" + content)


def wide(file):
    pq.write_table(pa.table({f"c{i}": np.zeros(2) for i in range(5000)}), file)


SPARSE = np.array([[1, 1, 1.0], [2**31 - 2, 2**31 - 2, 0.0]]).T.tobytes()
MARKET = "%%MatrixMarket matrix"
HOSTILE = {
    "a.tdms": lambda f: f.write_bytes(tdms(2 * 10**9, bytes(800))),
    "b.tdms": lambda f: f.write_bytes(tdms(0, bytes(800), "<IIIQQ", 28, 0x20, 1, 10**9, 4 * 10**9)),
    "c.tdms": lambda f: f.write_bytes(tdms(0, b"")[:40]),
    "d.tdms": segments,
    "a.uff": text(lambda: uff(2 * 10**9, ["  1.0  2.0"])),
    "b.uff": text(lambda: 1000 * uff(6, ["  1.0  2.0  3.0  4.0  5.0  6.0"])),
    "a.h5": hdf5(lambda f: f.create_dataset("x", (100,), "f8", chunks=(10**8,), maxshape=(None,))),
    "b.h5": hdf5(lambda f: f.create_dataset("x", (10**9,), "i1", chunks=(1000,))),
    "c.h5": hdf5(many_names),
    "d.h5": hdf5(long_unit),
    "a.mat": old_matlab(0, 2 * 10**9, 1),
    "b.mat": old_matlab(0, 50_000, 50_000),
    "c.mat": old_matlab(2, 2, 3, SPARSE),
    "a.parquet": wide,
    "a.csv": text(lambda: ",".join(f"a{i}" for i in range(200_000)) + "\n1"),
    "b.csv": text(lambda: 't,x\n1,2\n3,"' + 10**6 * "4,5\n"),
    "c.csv": text(lambda: "t,x\n" + ROWS + 10**6 * "1,"),
    "d.csv": text(lambda: "t,x\n" + ROWS + "1," + 10**6 * "9" + "\n"),
    "e.csv": text(lambda: "t,x\n" + 100 * ROWS + "".join(f"a{i},b\n" for i in range(200_000))),
    "f.csv": text(lambda: "t,x\n1,2\n" + 65_000 * " " + "\n" + ROWS),
    "g.csv": text(lambda: "t,x" + 30_000 * "[(" + "\n" + ROWS),
    "h.csv": text(lambda: 10**6 * "\n" + "t,x\n" + ROWS),
    "i.csv": text(lambda: "t,x\n" + 10**6 * "\n" + ROWS),
    "a.mtx": text(lambda: f"{MARKET} coordinate real general\n1000000000 1000000000 1\n1 1 1\n"),
    "b.mtx": text(lambda: f"{MARKET} array real general\n100000 100000\n1.0\n"),
    "c.mtx": text(lambda: f"{MARKET} coordinate real general\n9 9 9000000000\n1 1 1\n"),
}


def used(file):
    """What is done with a file: its matrix, or its columns and the numbers of the first."""
    if file.suffix == ".mtx":
        return read_matrices({"M": str(file), "K": str(file)})
    table = read_table(str(file))
    rows = table.rows({"record.time": table.columns[0]})
    return table.column(table.columns[0], "record.time", 0, rows, missing=True)


REFUSED = {
    "a.h5": "unpack to 0.8", "b.h5": "unpack to 8 GB", "a.mat": "unpack to 16 GB",
    "b.mat": "unpack to 20 GB", "a.mtx": "1000000000 rows", "b.mtx": "unpack to 80 GB",
    "c.mtx": "unpack to 144 GB",
}  # fmt: skip


def said(file):
    """The message where a file is refused."""
    try:
        used(file)
    except SpiralError as error:
        return str(error)
    return ""


@pytest.mark.hostile("files")
@pytest.mark.parametrize("name", HOSTILE)
def test_a_file_that_declares_much_is_read_or_refused_in_words(tmp_path, name):
    file = tmp_path / name
    HOSTILE[name](file)
    message = said(file)
    assert REFUSED.get(name, "") in message
    assert len(message) < 2000


def test_reading_has_a_limit_in_time_also_where_a_library_swallows_the_alarm():
    def work():
        while True:
            try:
                while True:
                    sum(range(1000))
            except InputError:
                if told:
                    raise
                told.append("swallowed")

    told = []
    with pytest.raises(InputError, match="had not ended after 0 s"), within_seconds(0.05):
        work()
    assert told == ["swallowed"]


MOST = containers.UNPACKED // 8 - 10**6  # numbers that are just not refused


FULL = {
    "a.npz": lambda f: flood(f, MOST),
    "b.npz": lambda f: flood(f, MOST, "|i1"),
    "a.h5": lambda f: hdf5(lambda h: h.create_dataset("a", (MOST,), chunks=(1000,)))(f),
    "b.h5": lambda f: hdf5(lambda h: h.create_dataset("a", (3, MOST // 3), chunks=(1, 10**6)))(f),
    "a.mat": lambda f: scipy.io.savemat(f, {"x": np.zeros(MOST)}, do_compression=True),
    "a.parquet": lambda f: pq.write_table(pa.table({"x": np.zeros(MOST // 2)}), f),
    "b.parquet": lambda f: pq.write_table(pa.table({"x": ["1.5"] * (MOST // 13)}), f),
}


@pytest.mark.slow
@pytest.mark.hostile("files")
@pytest.mark.parametrize("name", FULL)
def test_the_largest_file_that_is_not_refused_takes_little_enough(tmp_path, name):
    FULL[name](tmp_path / name)
    assert len(used(tmp_path / name))

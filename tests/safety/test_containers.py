"""Files of numbers that would hang, flood the memory, run code or read another file."""

import contextlib
import pickle
import struct
import subprocess
import sys
import time
import zipfile
import zlib
from pathlib import Path

import numpy as np
import openpyxl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io

from spiral.io.readers import containers, matlab
from spiral.io.readers.formats import read_table
from spiral.types.errors import InputError
from tests.safety.conftest import flood

h5py = pytest.importorskip("h5py")
NUMBERS = np.arange(100.0)


@pytest.fixture
def made(tmp_path):
    """A function that writes an HDF5 file with one good series, and more."""

    def make(add):
        file = tmp_path / "a.h5"
        with h5py.File(file, "w") as target:
            target["good"] = NUMBERS
            add(target)
        return file

    return make


def cycle(file):
    file.create_group("a/b")["c"] = NUMBERS
    file["a/b/again"] = h5py.SoftLink("/a")
    file["root"] = h5py.SoftLink("/")


def hard_cycle(file):
    inner = file.create_group("a")
    inner["self"] = inner


def dangling(file):
    file["gone"] = h5py.SoftLink("/nowhere")
    file["circle"] = h5py.SoftLink("/circle")


def many_cycles(file):
    """Ten links to the root in each of ten groups: 20 to the power 12 paths."""
    for i in range(10):
        group = file.create_group(f"g{i}")
        for j in range(10):
            group[f"l{j}"] = h5py.SoftLink(f"/g{(i + j) % 10}")


@pytest.mark.hostile("files")
@pytest.mark.parametrize(
    ("add", "said"),
    [(cycle, "again (a link to a group that it lies in)"), (dangling, "gone (a link to nothing)"),
     (hard_cycle, "self (a link to a group that it lies in)")],
)  # fmt: skip
def test_links_in_a_circle_or_to_nothing_are_left_out_and_named(made, add, said):
    table = read_table(str(made(add)))
    assert "good" in table.columns
    assert said in " ".join(table.notes)


@pytest.mark.hostile("files")
def test_a_maze_of_links_is_refused_in_time(made, monkeypatch):
    monkeypatch.setattr(containers, "_ITEMS", 2000)
    began = time.monotonic()
    with pytest.raises(InputError, match="arrays and groups"):
        read_table(str(made(many_cycles)))
    assert time.monotonic() - began < 10


@pytest.mark.hostile("files")
def test_no_other_file_is_read(made, tmp_path):
    """External storage showed any file of its owner as a column; links lead into other files."""
    secret = tmp_path / "secret"
    secret.write_bytes(NUMBERS.tobytes())
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["private"] = NUMBERS

    def add(file):
        file.create_dataset("raw", (100,), "f8", external=[(str(secret), 0, 800)])
        file["link"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/private")
        layout = h5py.VirtualLayout((100,), "f8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "private", (100,))
        file.create_virtual_dataset("virtual", layout)

    table = read_table(str(made(add)))
    assert table.columns == ("good",)
    for name in ("raw", "link", "virtual"):
        assert name in " ".join(table.notes)


@pytest.mark.hostile("files")
def test_an_array_that_is_only_declared_is_not_unpacked(made):
    """A terabyte of fill values takes no room in the file."""
    with pytest.raises(InputError, match="that unpack to"):
        read_table(str(made(lambda f: f.create_dataset("x", (10**11,), "f8", chunks=(1000,)))))


@pytest.mark.hostile("files")
def test_a_small_npz_that_unpacks_to_much_is_refused_before(tmp_path):
    """5.8 MB took 6.1 GB of memory."""
    file = tmp_path / "flood.npz"
    flood(file, 75_000_000)
    code = (
        "import re, sys; from spiral.io.readers import containers\n"
        "from spiral.io.readers.formats import read_table\n"
        "containers.UNPACKED = 10**8\n"
        "from spiral.types.errors import InputError\n"
        "try: read_table(sys.argv[1])\n"
        "except InputError as error: print(error.given)\n"
        "print(re.search(r'VmHWM:\\s+(\\d+)', open('/proc/self/status').read())[1])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(file)], capture_output=True, text=True, check=True
    )
    said, peak = done.stdout.splitlines()
    assert "that unpack to 0.6 GB" in said
    assert int(peak) < 500_000  # kB


@pytest.mark.hostile("files")
def test_a_workbook_that_unpacks_to_much_is_refused_before(tmp_path):
    file = tmp_path / "flood.xlsx"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xl/workbook.xml", b" " * 300_000_000)
    with pytest.raises(InputError, match="300 MB when unpacked"):
        read_table(str(file))
    file.write_bytes(file.read_bytes()[:10_000])
    with pytest.raises(InputError):
        read_table(str(file))


@pytest.mark.hostile("files")
def test_cells_far_out_of_a_workbook_take_little(tmp_path):
    book = openpyxl.Workbook()
    for row in range(1, 200):
        for column, value in ((1, row if row > 1 else "t"), (2, row / 7 if row > 1 else "x")):
            book.active.cell(row, column, value)
    book.active.cell(200, 16384, "far")
    book.active.cell(1_048_576, 1, "down")
    book.save(tmp_path / "far.xlsx")
    clock = time.process_time()
    with contextlib.suppress(InputError):
        read_table(str(tmp_path / "far.xlsx"))
    assert time.process_time() - clock < 30


def test_a_plain_large_file_is_no_flood():
    """What is as large on disk as in memory is the owner's affair."""
    containers.Allowance("a.npz", 5 * 10**9).take(5 * 10**9)
    with pytest.raises(InputError):
        containers.Allowance("a.npz", 10**9).take(9 * 10**9)


# --- MATLAB and Parquet --------------------------------------------------------------------------


def element(kind, content):
    """An element of a MATLAB file of version 5: its tag, its content, padding."""
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def matrix(kind, sizes, *content):
    """A variable x of a class (1 cell, 2 struct, 6 double) and so many rows and columns."""
    flags = element(6, struct.pack("<II", kind, 0))
    shape = element(5, struct.pack(f"<{len(sizes)}i", *sizes))
    return element(14, b"".join((flags, shape, element(1, b"x"), *content)))


def mat(file, *variables, deflated=True):
    """A MATLAB file of these variables."""
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x100) + b"IM"
    packed = (zlib.compress(v) if deflated else v for v in variables)
    tagged = (struct.pack("<II", 15, len(v)) + v if deflated else v for v in packed)
    file.write_bytes(head + b"".join(tagged))
    return str(file)


FIELDS = element(5, struct.pack("<i", 8)), element(1, b"a".ljust(8, b"\0") + b"b".ljust(8, b"\0"))


@pytest.mark.hostile("files")
@pytest.mark.parametrize(
    "variable",
    [
        matrix(1, (2**31 - 1, 1)),  # cells: 17 GB of empty places
        matrix(2, (2**20, 2**10), *FIELDS),
        matrix(6, (2**15, 2**15), element(2, bytes(100))),  # doubles kept as single bytes
        matrix(1, (1, 1), matrix(1, (1, 1), matrix(6, (10**5, 10**5)))),  # declared deep inside
        matrix(5, (10, 10)).replace(struct.pack("<II", 5, 0), struct.pack("<II", 5, 2**31), 1),
        matrix(4, (2**15, 2**15)),
    ],
    ids=["cells", "structs", "bytes", "nested", "sparse", "text"],
)
@pytest.mark.parametrize("deflated", [True, False])
def test_a_small_matlab_file_that_unpacks_to_much_is_refused_before(tmp_path, variable, deflated):
    with pytest.raises(InputError, match="that unpack to"):
        read_table(mat(tmp_path / "a.mat", variable, deflated=deflated))


@pytest.mark.hostile("files")
def test_a_name_of_a_matlab_file_is_not_unpacked_without_end(tmp_path):
    long = element(14, element(6, bytes(8)) + element(5, bytes(2 * 10**6)))
    with pytest.raises(InputError, match="a name of 2 MB"):
        read_table(mat(tmp_path / "a.mat", long))


@pytest.mark.hostile("files")
def test_a_matlab_file_that_breaks_off_is_no_traceback(tmp_path):
    whole = matrix(6, (100, 1), element(9, NUMBERS.tobytes()))
    file = mat(tmp_path / "a.mat", whole)
    assert list(read_table(file).columns) == ["x"]
    packed = Path(file).read_bytes()
    for size in range(128, len(packed), 7):
        Path(file).write_bytes(packed[:size])
        with pytest.raises(InputError):
            read_table(file)


def test_what_a_matlab_file_declares_is_what_it_unpacks_to(tmp_path):
    """Of cells, structs, texts and numbers as SciPy writes them, deflated and not."""
    inner = {
        "a": NUMBERS,
        "b": np.ones((3, 40), np.float32),
        "c": np.array([NUMBERS, "word"], object),
    }
    allowances = []
    for deflated in (True, False):
        file = tmp_path / f"{deflated}.mat"
        scipy.io.savemat(file, {"s": inner, "z": 1j * NUMBERS}, do_compression=deflated)
        allowances.append(containers.Allowance(str(file), 1))
        with file.open("rb") as opened:
            matlab._Declared(opened, allowances[-1]).count()
        assert {"s.a", "s.b[2]", "s.c[0]"} <= set(read_table(str(file)).columns)
    numbers = 8 * 100 + 8 * 120 + 8 * 100 + 16 * 100  # single ones are worked with as doubles
    references = 8 * 3 + 8 * 2
    assert [a.bytes for a in allowances] == [numbers + references + 4 * len("word")] * 2


@pytest.mark.hostile("files")
def test_parquet_that_unpacks_to_much_is_refused_before(tmp_path, monkeypatch):
    """A column of one value takes a few bytes for any number of rows."""
    monkeypatch.setattr(containers, "UNPACKED", 10**7)
    pq.write_table(pa.table({"t": np.zeros(10**6)}), tmp_path / "a.parquet", compression="zstd")
    assert (tmp_path / "a.parquet").stat().st_size < 10**5
    with pytest.raises(InputError, match="that unpack to"):
        read_table(str(tmp_path / "a.parquet"))


@pytest.mark.hostile("files")
def test_long_texts_and_lists_of_a_parquet_file_are_left_out_and_named(tmp_path):
    """A text of 1 MB in each of 1500 rows took 4.5 GB and 53 s."""
    rows = 1500
    columns = {"words": ["y" * 10**5] * rows, "lists": [[1.0, 2.0]] * rows,
               "t": np.arange(float(rows)), "typed": ["1.5"] * rows}  # fmt: skip
    pq.write_table(pa.table(columns), tmp_path / "a.parquet")
    table = read_table(str(tmp_path / "a.parquet"))
    assert table.columns == ("t", "typed")
    assert table.column("typed", "record.time", 0, 2).tolist() == [1.5, 1.5]
    assert "words (long texts)" in " ".join(table.notes)
    assert "lists (lists or structs)" in " ".join(table.notes)


# --- pickles, and names that promise another file ------------------------------------------------


class Runs:
    """Whoever unpickles this writes a file."""

    def __init__(self, trace):
        self.trace = trace

    def __reduce__(self):
        return (Path.write_text, (self.trace, "ran"))


@pytest.mark.hostile("files")
def test_no_pickle_is_loaded(tmp_path, trace):
    pickled = pickle.dumps(Runs(trace))
    for name in ("a.npz", "a.mat", "a.h5", "a.parquet", "a.csv"):
        (tmp_path / name).write_bytes(pickled)
        with pytest.raises(InputError):
            read_table(str(tmp_path / name))
    np.savez(tmp_path / "b.npz", x=np.array([Runs(trace)], dtype=object))
    with pytest.raises(InputError, match="'x' holds Python objects"):
        read_table(str(tmp_path / "b.npz"))
    assert not trace.exists()


@pytest.mark.hostile("files")
@pytest.mark.parametrize("suffix", [".gz", ".bz2", ".zip", ".xz", ".zst", ".tar"])
def test_a_text_file_is_not_unpacked_because_of_its_name(tmp_path, suffix):
    """pandas unpacks by the name: a packed file of any size, or a traceback."""
    file = tmp_path / f"a.csv{suffix}"
    file.write_text("t,x\n" + "".join(f"{i},{i}\n" for i in range(100)))
    assert list(read_table(str(file)).columns) == ["t", "x"]


@pytest.mark.hostile("saved runs")
def test_curves_of_a_saved_run_are_counted_before_they_are_unpacked(tmp_path, monkeypatch):
    from spiral.io.curves import FILE, read_curves

    monkeypatch.setattr(containers, "UNPACKED", 10**6)
    flood(tmp_path / FILE, 2_500_000)
    with pytest.raises(InputError, match="that unpack to"):
        read_curves(tmp_path)
    (tmp_path / FILE).write_bytes(b"PK\3\4" + bytes(100))
    with pytest.raises(InputError):
        read_curves(tmp_path)
    (tmp_path / FILE).write_bytes(pickle.dumps(NUMBERS))
    with pytest.raises(InputError, match="no NPZ file"):
        read_curves(tmp_path)

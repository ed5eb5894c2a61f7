"""HDF5 and NPZ files that would hang, flood the memory or read another file."""

import subprocess
import sys
import time
import zipfile

import numpy as np
import pytest

from spiral.io.readers import containers
from spiral.io.readers.readers import read_table
from spiral.types.errors import InputError

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


@pytest.mark.parametrize(
    ("add", "said"),
    [(cycle, "again (a link to a group that it lies in)"), (dangling, "gone (a link to nothing)"),
     (hard_cycle, "self (a link to a group that it lies in)")],
)  # fmt: skip
def test_links_in_a_circle_or_to_nothing_are_left_out_and_named(made, add, said):
    table = read_table(str(made(add)))
    assert "good" in table.columns
    assert said in " ".join(table.notes)


def test_a_maze_of_links_is_refused_in_time(made, monkeypatch):
    monkeypatch.setattr(containers, "_ITEMS", 2000)
    began = time.monotonic()
    with pytest.raises(InputError, match="arrays and groups"):
        read_table(str(made(many_cycles)))
    assert time.monotonic() - began < 10


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


def test_an_array_that_is_only_declared_is_not_unpacked(made):
    """A terabyte of fill values takes no room in the file."""
    with pytest.raises(InputError, match="that unpack to"):
        read_table(str(made(lambda f: f.create_dataset("x", (10**11,), "f8", chunks=(1000,)))))


def flood(file, gigabytes):
    """An NPZ that is small until it is unpacked."""
    count = int(gigabytes * 10**9) // 8
    shape = {"descr": "<f8", "fortran_order": False, "shape": (count,)}
    packed = zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1)
    with packed, packed.open("x.npy", "w", force_zip64=True) as target:
        np.lib.format.write_array_header_1_0(target, shape)
        for _ in range(8 * count // 10**7):
            target.write(bytes(10**7))


def test_a_small_npz_that_unpacks_to_much_is_refused_before(tmp_path):
    """5.8 MB took 6.1 GB of memory."""
    file = tmp_path / "flood.npz"
    flood(file, 0.6)
    code = (
        "import re, sys; from spiral.io.readers import containers\n"
        "from spiral.io.readers.readers import read_table\n"
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


def test_a_plain_large_file_is_no_flood():
    """What is as large on disk as in memory is the owner's affair."""
    containers.Allowance("a.npz", 5 * 10**9).take(5 * 10**9)
    with pytest.raises(InputError):
        containers.Allowance("a.npz", 10**9).take(5 * 10**9)

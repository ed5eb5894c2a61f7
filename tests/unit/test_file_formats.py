"""Every format reads back the same, and a broken file is one clear message."""

import contextlib
import os
import sys
import tempfile
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import pyuff
from hypothesis import given, settings
from hypothesis import strategies as st
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from spiral.io.readers.formats import read_table
from spiral.io.registry import load_registry
from spiral.types.errors import ConfigError, InputError

REGISTRY = load_registry()
OSCILLATOR = REGISTRY.make("system", "oscillator")
COUNT = 100
RNG = np.random.default_rng(0)
TIME, A, F = 0.01 * np.arange(COUNT), RNG.normal(size=COUNT), RNG.normal(size=COUNT)


def load(path, x, force, time="t", **fields):
    fields = {"path": str(path), "channels": {"x": x}, "inputs": {"force": force}, **fields}
    if "rate" not in fields:
        fields["time"] = time
    return REGISTRY.make("source", "file", fields, "record").load(OSCILLATOR)[0]


def agrees(record, size=1.0):
    np.testing.assert_allclose(record.channels["x"], size * A, rtol=1e-6)
    np.testing.assert_allclose(record.inputs["force"], F, rtol=1e-6)
    assert record.dt == pytest.approx(0.01)
    assert record.notes


def cells(*items):
    array = np.empty((1, len(items)), dtype=object)
    array[0, :] = items
    return array


def mat5(path):
    savemat(path, {"t": TIME, "Y": cells(np.stack([F, A]), A), "s": {"f": F[:, None], "n": "word"}})


def mat73(path):
    with h5py.File(path, "w", userblock_size=512) as file:
        file["t"] = TIME[None, :]
        inside = file.create_group("#refs#")
        inside["a"] = np.stack([F, A]).T
        references = np.array([[inside["a"].ref]], dtype=h5py.ref_dtype)
        file.create_dataset("Y", data=references).attrs["MATLAB_class"] = np.bytes_("cell")
        struct = file.create_group("s")
        struct.attrs["MATLAB_class"] = np.bytes_("struct")
        struct["f"] = F[None, :]
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64")


def npz(path):
    np.savez(path, t=TIME, Y=np.column_stack([F, A]), f=F, word=np.array("x"))


def parquet(path):
    moments = pd.Timestamp("2024-01-01") + pd.to_timedelta(TIME, unit="s")
    pd.DataFrame({"t": moments, "a": A, "f": F}).to_parquet(path)


def hdf5(path):
    with h5py.File(path, "w") as file:
        file["rig/t"] = TIME
        file["rig/a"] = A
        file["rig/a"].attrs["units"] = "um"
        file["rig/f"] = F


def uff(path):
    for number, values in enumerate((A, F)):
        function = pyuff.prepare_58(
            binary=0, func_type=1, rsp_node=number + 1, rsp_dir=1, ref_node=1, ref_dir=1,
            data=values, x=TIME, id1=f"probe {number}", rsp_ent_name="NONE",
            ref_ent_name="NONE", abscissa_spacing=1, abscissa_spec_data_type=17,
            ordinate_spec_data_type=8, orddenom_spec_data_type=13, ord_data_type=4,
            num_pts=COUNT, abscissa_min=0.0, abscissa_inc=0.01,
        )  # fmt: skip
        pyuff.UFF(str(path)).write_sets(function, "overwrite" if number == 0 else "add")


def tdms(path):
    interval = {"wf_increment": 0.01, "wf_start_offset": 0.0}
    with TdmsWriter(str(path)) as writer:
        writer.write_segment(
            [
                ChannelObject("rig", "a", A, {"unit_string": "mm", **interval}),
                ChannelObject("rig", "f", F, interval),
            ]
        )


def xlsx(path):
    with pd.ExcelWriter(path, engine="openpyxl") as book:
        pd.DataFrame({"made by": ["B"]}).to_excel(book, sheet_name="about", index=False)
        table = pd.DataFrame({"t": TIME, "a [mm]": A, "f": F, "remark": ""})
        table.to_excel(book, sheet_name="run 1", index=False, startrow=2)


FORMATS = {
    "a.mat": (mat5, "Y[0][1]", "s.f", "t", 1.0),
    "b.mat": (mat73, "Y[0][1]", "s.f", "t", 1.0),
    "a.npz": (npz, "Y[1]", "f", "t", 1.0),
    "a.parquet": (parquet, "a", "f", "t", 1.0),
    "a.h5": (hdf5, "rig/a", "rig/f", "rig/t", 1e-6),
    "a.uff": (uff, "data[0]", "data[1]", "time", 1.0),
    "a.tdms": (tdms, "rig/a", "rig/f", "time", 1e-3),
    "a.xlsx": (xlsx, "a", "f", "t", 1e-3),
}


@pytest.mark.parametrize("name", FORMATS)
def test_what_was_written_is_read(tmp_path, name):
    write, x, force, time, size = FORMATS[name]
    write(tmp_path / name)
    agrees(load(tmp_path / name, x, force, time), size)


@pytest.mark.parametrize("name", FORMATS)
def test_the_content_decides_whatever_the_name(tmp_path, name):
    write, x, force, time, size = FORMATS[name]
    write(tmp_path / name)
    (tmp_path / name).rename(tmp_path / "a.bin")
    agrees(load(tmp_path / "a.bin", x, force, time), size)


def test_of_a_workbook_with_several_tables_columns_are_named_with_their_sheet(tmp_path):
    file = tmp_path / "a.xlsx"
    moments = pd.Timestamp("2026-01-01") + pd.to_timedelta(TIME, unit="s")
    with pd.ExcelWriter(file, engine="openpyxl") as book:
        for sheet, values in (("one", F), ("two", A)):
            table = pd.DataFrame({"t": moments, "x": values, "f": F})
            table.to_excel(book, sheet_name=sheet, index=False)
    agrees(load(file, "two/x", "one/f", "two/t"))


def test_spreadsheets_that_are_no_excel_workbooks_are_told_what_to_become(tmp_path):
    for name in ("content.xml", "Index/Document.iwa"):
        with zipfile.ZipFile(tmp_path / "a.ods", "w") as archive:
            archive.writestr(name, "x")
        with pytest.raises(InputError, match="no Excel workbook"):
            read_table(str(tmp_path / "a.ods"))


def test_text_by_the_same_source(tmp_path):
    rows = np.column_stack([TIME, A, F])
    np.savetxt(tmp_path / "a.txt", rows, delimiter="\t", header="t\ta\tf", fmt="%.17g")
    agrees(load(tmp_path / "a.txt", "a", "f"))


def test_rows_rate_and_units(tmp_path):
    mat5(tmp_path / "a.mat")
    record = load(tmp_path / "a.mat", "Y[1]", "s.f", rate=100.0, rows=[10, 90], units={"x": "mm"})
    np.testing.assert_allclose(record.channels["x"], 1e-3 * A[10:90])
    assert record.dt == pytest.approx(0.01)


def test_near_misses_and_lengths(tmp_path):
    np.savez(tmp_path / "a.npz", t=TIME, Y=np.stack([A, F]), short=A[:70])
    with pytest.raises(InputError) as caught:
        load(tmp_path / "a.npz", "Y", "Y[1]")
    assert "'Y[0]'" in caught.value.try_
    assert "t, Y[0], Y[1]" in caught.value.expected
    with pytest.raises(InputError, match="different lengths"):
        load(tmp_path / "a.npz", "short", "Y[1]")


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("share", [0.02, 0.5, 0.98])
def test_a_file_cut_short_is_told(tmp_path, name, share):
    write, x, force, time, _ = FORMATS[name]
    write(tmp_path / name)
    content = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(content[: int(share * len(content))])
    with contextlib.suppress(InputError):
        load(tmp_path / name, x, force, time)


@settings(max_examples=60, deadline=None)
@given(name=st.sampled_from(sorted(FORMATS)), content=st.binary(min_size=1, max_size=400),
       keep=st.integers(0, 600))  # fmt: skip
def test_any_bytes_are_one_clear_message(name, content, keep):
    """Random bytes alone (keep 0) or over the middle of a file that was whole."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        if keep > 100:
            FORMATS[name][0](path)
            whole = path.read_bytes()
            content = whole[:keep] + content + whole[keep + len(content) :]
        path.write_bytes(content)
        with contextlib.suppress(InputError):
            load(path, *FORMATS[name][1:4])


@pytest.mark.parametrize("seed", range(3))
def test_a_damaged_matlab_file_is_refused_and_ends_no_process(tmp_path, seed):
    """Single bytes changed anywhere; SciPy alone crashes on some of these."""
    rng = np.random.default_rng(seed)
    mat5(tmp_path / "a.mat")
    whole, path = (tmp_path / "a.mat").read_bytes(), tmp_path / "b.mat"
    for place in rng.integers(128, len(whole), 400):
        content = bytearray(whole)
        for at in range(place, min(place + rng.integers(1, 9), len(whole))):
            content[at] = rng.choice([0, 1, 5, 6, 8, 9, 10, 14, 15, 20, 99, 255])
        path.write_bytes(bytes(content))
        with contextlib.suppress(InputError), np.errstate(all="ignore"):
            load(path, "Y[1]", "s.f", rate=100.0)


def test_objects_of_matlab_are_left_out_and_series_beside_them_read(tmp_path):
    path = tmp_path / "a.mat"
    savemat(path, {"kept": A, "object": F})
    content = bytearray(path.read_bytes())
    content[content.index(b"object") - 32] = 17  # the class in its flags: an object of a newer one
    path.write_bytes(bytes(content))
    with pytest.raises(InputError) as caught:
        load(path, "kept", "object", rate=100.0)
    assert "kept" in caught.value.expected
    assert "object" not in caught.value.expected


@pytest.mark.parametrize("module", ["h5py", "pyuff", "nptdms", "openpyxl"])
def test_a_missing_library_names_the_extra(tmp_path, monkeypatch, module):
    names = {"h5py": "a.h5", "pyuff": "a.uff", "nptdms": "a.tdms", "openpyxl": "a.xlsx"}
    name = names[module]
    FORMATS[name][0](tmp_path / name)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ConfigError, match="formats"):
        load(tmp_path / name, "a", "f")


def test_csv_points_to_file_for_other_formats(tmp_path):
    tdms(tmp_path / "a.tdms")
    source = REGISTRY.make("source", "csv", {"path": str(tmp_path / "a.tdms")}, "record")
    with pytest.raises(InputError, match="record=file"):
        source.load(OSCILLATOR)


PENDULUM = Path(os.environ.get("SPIRAL_DATA", "none"), "multiarm_pendulum")
PENDULUM = PENDULUM / "SinglePendulumDataForParameterEstimation.mat"


@pytest.mark.skipif(not PENDULUM.is_file(), reason="SPIRAL_DATA has no multiarm_pendulum")
def test_cells_of_the_measured_pendulum():
    table = read_table(str(PENDULUM))
    columns = [table.column(c, "", 0, 9167) for c in ("Time_id[0]", "Y_id[0][0]", "Y_id[0][1]")]
    time, angle, rate = columns
    assert np.diff(time).mean() == pytest.approx(1e-3, rel=1e-6)
    assert np.corrcoef(np.gradient(angle, time), rate)[0, 1] > 0.99

"""Bad input, one table: exit 2, one message that names the culprit, no traceback, nothing written.

Through the command line with the real steps. Divergence is an outcome (exit 3), and a clipped
channel a warning.
"""

import json
import textwrap
from pathlib import Path

import numpy as np
import pytest

from spiral.cli import main

SAMPLES = 300
RATE = 100.0
PLUGINS = {
    "branching": """
        class Branching(ForceEffect):
            \"\"\"A push to one side: F = -f where q > 0.\"\"\"

            parameters = (Parameter("push", "force"),)

            def force(self, at, u, p):
                return [-p.push if q > 0 else 0 * p.push for q in at.position]
        """,
    "scalar_only": """
        class ScalarOnly(ForceEffect):
            \"\"\"F = -f sin(q / g) with a function that takes one number.\"\"\"

            parameters = (Parameter("push", "force"), Parameter("gap", "position", start=1.0))

            def force(self, at, u, p):
                return [-p.push * math.sin(q / p.gap) for q in at.position]
        """,
    "restless": """
        class Restless(ForceEffect):
            \"\"\"F = -f q/|q|, 0/0 at rest.\"\"\"

            parameters = (Parameter("push", "force"),)

            def force(self, at, u, p):
                return [-p.push * q / sqrt(q * q) for q in at.position]
        """,
    "wrong_unit": """
        class WrongUnit(ForceEffect):
            \"\"\"F = -f q with f a force.\"\"\"

            parameters = (Parameter("push", "force"),)

            def force(self, at, u, p):
                return [-p.push * q for q in at.position]
        """,
    "unimportable": "import a_library_that_is_not_there",
    "unparsable": "class Broken(:",
}
HEADER = '''"""A plugin of a test."""

import math

from spiral.types.effect import ForceEffect
from spiral.math import sqrt
from spiral.types.parameter import Parameter

'''


def motion(noise=1e-5):
    """x of x'' + 4 x' + 400 x = f, with a random f held over each sample."""
    from scipy.signal import StateSpace, dlsim

    rng = np.random.default_rng(0)
    time = np.arange(SAMPLES) / RATE
    force = rng.normal(size=SAMPLES)
    system = StateSpace([[0, 1], [-400, -4]], [[0], [1]], [[1, 0]], [[0]]).to_discrete(1 / RATE)
    _, x, _ = dlsim(system, force)
    return {"t": time, "a": x[:, 0] + noise * rng.normal(size=SAMPLES), "f": force}


def write(name, table, dropped=()):
    rows = [
        ",".join(str(v) for v in row)
        for i, row in enumerate(zip(*table.values(), strict=True))
        if i not in dropped
    ]
    Path(name).write_text("\n".join([",".join(table), *rows]) + "\n")


def with_cell(column, row, cell):
    table = {k: v.astype(object) for k, v in motion().items()}
    table[column][row] = cell
    return table


def make_files():
    good = motion()
    write("good.csv", good)
    write("text.csv", with_cell("a", 17, "n/a?"))
    write("nan.csv", with_cell("a", 17, "nan"))
    write("hole.csv", with_cell("f", 17, ""))
    write("lost_rows.csv", good, dropped=(50, 51))
    write("backwards.csv", with_cell("t", 40, 0.1))
    write("repeated.csv", with_cell("t", 40, good["t"][39]))
    uneven = good["t"] + 0.002 * np.random.default_rng(1).uniform(size=SAMPLES)
    write("uneven.csv", {**good, "t": uneven})
    write("constant.csv", {**good, "a": np.full(SAMPLES, 0.5)})
    write("short.csv", {k: v[:30] for k, v in good.items()})
    write("clipped.csv", {**good, "a": np.clip(good["a"], -2e-3, 2e-3)})
    write("ragged.csv", with_cell("f", 17, "1,2"))
    write("names_only.csv", {k: v[:0] for k, v in good.items()})
    phase = 2 * np.pi * 8 * good["t"]
    write("rotor.csv", {"t": good["t"], "a": good["a"], "b": good["a"][::-1],
                        "n": np.full(SAMPLES, 480.0), "key": np.cos(phase)})  # fmt: skip
    Path("empty.csv").write_bytes(b"")
    Path("blank.csv").write_text("\n \n\n")
    Path("binary.csv").write_bytes(bytes(range(256)) * 40)
    Path("broken.mat").write_bytes(b"MATLAB 5.0 MAT-file" + bytes(200))
    Path("broken.parquet").write_bytes(b"PAR1" + bytes(50))
    Path("a_folder").mkdir()
    for name, text in PLUGINS.items():
        Path("mine", name).mkdir(parents=True)
        body = HEADER + textwrap.dedent(text) if "class" in text and "(:" not in text else text
        Path("mine", name, f"{name}.py").write_text(body)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The files of the table, made once."""
    place = tmp_path_factory.mktemp("bad")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        make_files()
    return place


@pytest.fixture
def here(folder, monkeypatch):
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.delenv("SPIRAL_DATA", raising=False)
    return folder


def own(file="good.csv", *more, source="csv"):
    return ("system=oscillator", f"record={source}", f"record.path={file}", "record.time=t",
            "record.channels={x: a}", "record.inputs={force: f}", *more)  # fmt: skip


def turning(*more, inputs="{speed: n}"):
    return ("system=planar_rotor", "record=csv", "record.path=rotor.csv", "record.time=t",
            "record.channels={x: a, y: b}", f"record.inputs={inputs}",
            "record.units={speed: rpm}", *more)  # fmt: skip


def plugin(name, *more):
    return (*own(), f"candidates=[{name}]", "--plugins", f"mine/{name}", *more)


TABLE = {
    # files and columns
    "missing file": (own("god.csv"), ["god.csv", "good.csv"]),
    "missing file, none near": (own("measured_7"), ["measured_7", "SPIRAL_DATA"]),
    "a folder": (own("a_folder"), ["a_folder", "a folder"]),
    "no file": (own()[:2], ["record.path"]),
    "empty": (own("empty.csv"), ["empty.csv", "empty"]),
    "blank": (own("blank.csv"), ["blank.csv", "blank"]),
    "binary": (own("binary.csv"), ["binary.csv", "binary"]),
    "names only": (own("names_only.csv"), ["names_only.csv", "no rows"]),
    "ragged": (own("ragged.csv"), ["ragged.csv"]),
    "broken MAT": (own("broken.mat", source="file"), ["broken.mat", "MATLAB"]),
    "broken Parquet": (own("broken.parquet", source="file"), ["broken.parquet", "Parquet"]),
    "missing column": (own("good.csv", "record.channels={x: aa}"), ["'aa'", "'a'"]),
    "missing channel": (own("good.csv", "record.channels={y: a}"), ["'y'", "x"]),
    "missing time": (own("good.csv", "record.time=time"), ["'time'", "'t'"]),
    "rows out of range": (own("good.csv", "record.rows=[0,900]"), ["900", "300"]),
    # numbers
    "wrong unit": (own("good.csv", "record.units={x: kg}"), ["'kg'", "x", "'m'"]),
    "unknown unit": (own("good.csv", "record.units={x: furlogn}"), ["furlogn"]),
    "text": (own("text.csv"), ["'n/a?'", "row 17", "line 19", "'a'"]),
    "NaN": (own("nan.csv"), ["row 17", "'a'", "record.fill_gaps=1"]),
    "a hole": (own("hole.csv"), ["row 17", "'f'", "record.fill_gaps=1"]),
    "lost rows": (own("lost_rows.csv"), ["row 49", "record.fill_gaps=2"]),
    "lost rows, longer": (own("lost_rows.csv", "record.fill_gaps=1"), ["gap of 2", "record.rows"]),
    "time backwards": (own("backwards.csv"), ["row 40", "increases"]),
    "time repeated": (own("repeated.csv"), ["row 40", "increases"]),
    "time uneven": (own("uneven.csv"), ["steps of time differ", "record.resample"]),
    "constant": (own("constant.csv"), ["'x'", "constant", "0.5"]),
    "too few": (own("short.csv"), ["30 samples", "64"]),
    "too few rows": (own("good.csv", "record.rows=[0,20]"), ["20 samples", "64"]),
    "noise below zero": (own("good.csv", "record.noise={x: -1}"), ["noise", "-1"]),
    # names and near misses
    "verb": (None, ["'discover'"]),
    "system": (("system=oscilator", *own()[1:]), ["oscilator", "'oscillator'"]),
    "system, prefix": (("system=osc", *own()[1:]), ["'osc'", "'oscillator'"]),
    "source, prefix": (("system=oscillator", "record=cs"), ["'cs'", "'csv'"]),
    "key": (own("good.csv", "hold=0.2"), ["'hold'", "'holdout'"]),
    "field": (own("good.csv", "record.pth=b"), ["record.pth", "'path'"]),
    "field, prefix": (own("good.csv", "record.probe={x: 45}"), ["'probe_angles'"]),
    "added field": (own("good.csv", "+record.pulses=key"), ["'pulse'"]),
    "experiment": (("experiment=rotor_coast",), ["'rotor_coastdown'"]),
    "effect": (own("good.csv", "effect=[cubic]"), ["'cubic'", "'cubic_stiffness'"]),
    "candidate": (own("good.csv", "candidates=[clear]"), ["'clear'", "'clearance'"]),
    "wrong type": (own("good.csv", "record.rate=fast"), ["record.rate", "fast", "a number"]),
    "wrong choice": (turning("record.rotation=left"), ["left", "clockwise"]),
    "no override": (own("good.csv", "record.channels={x: "), ["record.channels"]),
    # plugins
    "fails to import": (plugin("unimportable"), ["unimportable.py", "a_library_that_is_not_there"]),
    "does not parse": (plugin("unparsable"), ["unparsable.py", "SyntaxError"]),
    "branches": (plugin("branching"), ["'branching'", "branching.py, line", "where("]),
    "takes one number": (plugin("scalar_only"), ["'scalar_only'", "scalar_only.py, line"]),
    "NaN at rest": (plugin("restless"), ["'restless'", "at rest", "spiral.math.length"]),
    "NaN at rest, in the model": (
        (*own(), "effect=[restless]", "candidates=[]", "--plugins", "mine/restless"),
        ["'restless'", "at rest"],
    ),
    "needs two axes": (own("good.csv", "candidates=[gyroscopic]"), ["'gyroscopic'", "2 axes"]),
    "needs speed": (own("good.csv", "effect=[speed_stiffness]"), ["'speed_stiffness'", "'speed'"]),
    "needs a port": (own("good.csv", "effect=[clearance@bearing]"), ["'bearing'", "mass"]),
    "plugin folder": ((*own(), "--plugins", "nowhere"), ["nowhere", "--plugins"]),
    # a rotor's options
    "no such pulse": (turning("record.pulse=kye"), ["'kye'", "'key'"]),
    "pulses that are none": (turning("record.pulse=a"), ["record.pulse=a"]),
    "constant pulse": (turning("record.pulse=n"), ["record.pulse=n", "constant"]),
    "speed and pulses differ": (
        turning("record.pulse=key", "record.units={speed: Hz}"),
        ["turns by phase", "record.units"],
    ),
    "pulse of no rotor": (own("good.csv", "record.pulse=a"), ["record.pulse=a", "rotor"]),
    "edge without pulse": (turning("record.pulse_edge=rising"), ["pulse_edge", "record.pulse"]),
    "one probe": (turning("record.probe_angles={x: 45}"), ["probe_angles", "two channels"]),
    "probes in line": (turning("record.probe_angles={x: 45, y: 225}"), ["225", "apart"]),
    "slow roll without phase": (turning("record.slow_roll={rows: [0, 100]}"), ["phase", "pulse"]),
    "not slow": (
        turning("record.pulse=key", "record.slow_roll={rows: [0, 200]}"),
        ["speed reaches", "record.slow_roll"],
    ),
    "slow roll, neither": (turning("record.slow_roll={row: [0, 9]}"), ["'rows'", "slow_roll"]),
    "faster than measured": (own("good.csv", "record.resample=1000"), ["1000", "100 samples"]),
    "no gap length": (own("good.csv", "record.fill_gaps=0"), ["fill_gaps=0"]),
}  # fmt: skip


def files(folder):
    """Every file below, what Python keeps of a plugin left out."""
    found = (p for p in sorted(folder.rglob("*")) if p.is_file())
    return [p for p in found if "__pycache__" not in p.parts]


@pytest.mark.parametrize("case", TABLE)
def test_bad_input(here, capsys, case):
    words, culprits = TABLE[case]
    before = files(here)
    given = ["discover", *words, "out=runs"] if words is not None else ["discovr"]
    assert main([*given, "--json", "-"]) == 2
    told = capsys.readouterr()
    for culprit in culprits:
        assert culprit in told.err, told.err
    assert told.err.count("given:") == told.err.count("expected:") == 1
    assert "Traceback" not in told.err
    error = json.loads(told.out)["error"]
    assert set(error) == {"given", "expected", "try"}
    assert error["given"]
    assert error["expected"]
    assert files(here) == before


def test_a_plugin_of_another_unit_is_no_candidate_but_is_refused_by_name(here, capsys):
    """Units that do not fit keep it out of the list, as those of shipped effects do."""
    assert main(["check", "wrong_unit", "--plugins", "mine/wrong_unit"]) == 2
    assert "wrong_unit" in capsys.readouterr().out


def test_a_broken_sibling_is_told_and_stops_nothing(here, capsys):
    words = own("short.csv", "--plugins", "mine/unimportable")
    assert main(["compare", *words]) == 2
    told = capsys.readouterr().err
    assert "not usable: unimportable in" in told
    assert "30 samples" in told


def test_a_clipped_channel_is_a_warning_with_its_share(here, capsys):
    assert main(["compare", *own("clipped.csv"), "out=runs", "--json", "result.json"]) == 0
    result = json.loads((here / "result.json").read_text())
    note = next(n for n in result["spoilt"] if "clips" in n)
    values = np.loadtxt("clipped.csv", delimiter=",", skiprows=1)[:240, 1]  # without the hold-out
    flat = int(np.sum(np.abs(values) >= 2e-3))
    assert note.startswith(f"sensor x: {flat} readings ({100 * flat / 240:.3g} %)")
    assert "the sensor clips" in capsys.readouterr().out
    (here / "result.json").unlink()


def test_divergence_is_an_outcome(here, capsys):
    """A model that runs away from the record: figures are given, exit 3, no traceback."""
    runaway = ("values={linear_damping.damping: -3000}", "fixed=[linear_damping.damping]",
               "strategy=shooting")  # fmt: skip
    assert main(["compare", *own(), *runaway, "out=runs", "--json", "-"]) == 3
    told = capsys.readouterr()
    result = json.loads(told.out)
    assert set(result["error"]) == {"given", "expected", "try"}
    assert "fit_error" in result
    assert "Traceback" not in told.err

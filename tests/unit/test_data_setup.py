"""Records of a setup: stretches that never overlap, files and sensors as on the command line."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from spiral.app.data_setup import foresight_message
from spiral.app.identifiability import identifiability_forecast
from spiral.app.record_setup import (
    AT_REST,
    FIT,
    TEST,
    Choice,
    RecordSetup,
    mark_stretch,
    missing_choices,
    places_of_settings,
    setup_overrides,
    units_taken,
    with_setting,
    without_test_rows,
)
from spiral.io.config import build_problem, build_sources, compose
from tests.described_systems import OSCILLATOR, ROTOR
from tests.scenes import registry

ROWS = 1000


def setup(system, columns, **choice):
    found = Choice(system["name"], "t", "", columns, **choice)
    return RecordSetup("20260101-000000-abc", "a.csv", "a.csv", rows=ROWS, systems=(system,),
                       choice=found)  # fmt: skip


@pytest.mark.parametrize("use", [FIT, TEST])
def test_stretches_of_fit_and_test_never_overlap_and_lie_in_the_record(use):
    """Whatever is marked first, and over which ends of the record."""
    ends = (-50, 0, 100, 500, 900, 1000, 1200)
    for a, b, c, d in product(ends, repeat=4):
        if min(max(a, b), ROWS) <= max(min(a, b), 0) or min(max(c, d), ROWS) <= max(min(c, d), 0):
            continue
        other = FIT if use == TEST else TEST
        found = mark_stretch(mark_stretch(Choice(), other, a, b, ROWS), use, c, d, ROWS)
        mine, rest = (found.fit_rows, found.test_rows)[:: 1 if use == FIT else -1]
        assert mine == (max(0, min(c, d)), min(ROWS, max(c, d)))
        if rest:
            assert 0 <= rest[0] < rest[1] <= ROWS
            assert rest[1] <= mine[0] or rest[0] >= mine[1]


def test_the_test_alone_leaves_the_longer_side_to_the_fit():
    assert mark_stretch(Choice(), TEST, 200, 500, ROWS).fit_rows == (500, 1000)
    assert mark_stretch(Choice(), TEST, 600, 900, ROWS).fit_rows == (0, 600)
    assert mark_stretch(Choice(), FIT, 200, 500, ROWS).test_rows == ()


def test_a_file_as_the_test_gives_back_the_rows_that_only_the_mark_of_a_test_took():
    marked = mark_stretch(Choice(), TEST, 200, 500, ROWS)
    assert without_test_rows(marked, ROWS) == Choice()
    chosen = mark_stretch(mark_stretch(Choice(), FIT, 0, 400, ROWS), TEST, 600, 900, ROWS)
    assert without_test_rows(chosen, ROWS) == Choice(fit_rows=(0, 400))


def test_files_stretches_and_sensors_are_those_of_the_command_line(tmp_path):
    time = np.arange(ROWS) / 500.0
    known = registry()
    rng = np.random.default_rng(0)
    for name in ("a", "it's b", "c"):
        table = np.column_stack([time, rng.normal(size=(ROWS, 2))])
        np.savetxt(tmp_path / f"{name}.csv", table, delimiter=",", header="t,x,f", comments="")
    wanted = setup(OSCILLATOR, {"x": "x", "force": "f"}, fit_rows=(100, 600), test_rows=(700, 900),
                   hold={"force": "zero_order"})  # fmt: skip
    wanted = replace(wanted, path=str(tmp_path / "a.csv"))
    system = known.make("system", "oscillator")
    record, test = build_sources(compose(setup_overrides(wanted), known), known)
    assert [r.samples for r in record.load(system)] == [500]
    assert [r.samples for r in test.load(system)] == [200]
    assert record.load(system)[0].hold == {"force": "zero_order"}
    others = ({"path": str(tmp_path / "it's b.csv"), "name": "b", "use": FIT},
              {"path": str(tmp_path / "c.csv"), "name": "c", "use": TEST})  # fmt: skip
    record, test = build_sources(
        compose(setup_overrides(replace(wanted, others=others)), known), known
    )
    assert [r.samples for r in record.load(system)] == [500, 500]
    assert [r.samples for r in test.load(system)] == [ROWS]  # its own rows, all of them


def test_a_pulse_stands_for_the_speed_and_probes_for_their_angles():
    columns = {"x": "p1", "y": "p2"}
    assert missing_choices(setup(ROTOR, columns)) == ["a column for speed"]
    found = setup(ROTOR, columns, pulse="key", rotation="clockwise",
                  angles={"x": "45", "y": "135"},
                  slow_roll={"from": "200", "to": " 400"})  # fmt: skip
    assert missing_choices(found) == []
    source, _ = build_sources(compose(setup_overrides(found), registry()), registry())
    assert (source.pulse, source.rotation) == ("key", "clockwise")
    assert source.probe_angles == {"x": 45, "y": 135}
    assert source.slow_roll == {"speed": [200, 400]}
    half = replace(found, choice=replace(found.choice, slow_roll={"from": "200", "to": ""}))
    assert not any("slow_roll" in line for line in setup_overrides(half))


def test_units_that_nobody_gave_are_told():
    columns = ({"name": "x", "unit": "mm"}, {"name": "f", "unit": ""}, {"name": "t", "unit": ""})
    given = replace(setup(OSCILLATOR, {"x": "x", "force": "f"}), columns=columns)
    assert units_taken(given) == ["force in N", "time in s"]
    typed = replace(given.choice, units={"force": "kN", "time": "ms"})
    assert units_taken(replace(given, choice=typed)) == []
    assert units_taken(setup(OSCILLATOR, {"x": "x", "force": AT_REST})) == ["x in m", "time in s"]


def test_settings_in_a_message_are_told_by_their_place_on_the_page():
    said = places_of_settings({
        "given": "unit 'q' of x", "expected": "one that converts",
        "try": "correct record.units, or cut it with record.rows=[0, 9]; record.missing=leave_out",
    })  # fmt: skip
    assert "<code>record.units</code> in the field beside each column" in said
    assert "<code>record.rows</code> in <i>Fitted rows</i>" in said
    assert "<code>record.missing</code> under <i>More</i>" in said
    assert places_of_settings({"given": "an empty file", "try": "export it again"}) == ""


@pytest.mark.parametrize(("speeds", "alike"), [((20.0, 20.0), True), ((40.0, 5.0), False)])
def test_a_constant_speed_cannot_tell_what_a_run_down_can(tmp_path, speeds, alike):
    """At one speed, once settled, all linear terms together are two numbers for each channel."""
    from tests.scenes import planar_record

    record = planar_record(3, noise=0.01, duration=10.0, hertz=speeds)
    table = np.column_stack([record.time, record.channels["x"], record.channels["y"],
                             record.inputs["speed"]])  # fmt: skip
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header="t,x,y,n", comments="")
    given = setup(ROTOR, {"x": "x", "y": "y", "speed": "n"}, fit_rows=(6000, 10000),
                  test_rows=(0, 6000))  # fmt: skip
    known = registry()
    config = compose(
        (*setup_overrides(replace(given, path=str(tmp_path / "a.csv"))),
         "candidates=[cross_stiffness,cross_damping,gyroscopic]"), known,
    )  # fmt: skip
    found = identifiability_forecast(build_problem(config, known), config, known)
    assert bool(found["alike"]) is alike
    assert ("cannot tell" in foresight_message(found, False)) is alike
    if alike:
        assert "linear stiffness (in the model)" in foresight_message(found, False)
        assert "take a run-up or run-down" in foresight_message(found, False)


def test_rate_gaps_and_offsets_are_those_of_the_command_line():
    wanted = setup(OSCILLATOR, {"x": "x", "force": AT_REST}, offsets={"x": "0.1", "force": "2"})
    wanted = replace(wanted, choice=with_setting(wanted.choice, "record.resample=250"))
    wanted = replace(wanted, choice=with_setting(wanted.choice, "record.noise={x: 1}"))
    assert wanted.choice.more == "record.noise={x: 1}"
    source, _ = build_sources(compose(setup_overrides(wanted), registry()), registry())
    assert source.resample == 250
    assert source.offset == {"x": 0.1}  # what is held at zero has none
    assert source.inputs == {"force": "0"}
    assert source.noise == {"x": 1}


def test_an_input_held_at_zero_is_none_of_the_files_columns(tmp_path):
    table = np.column_stack([np.arange(ROWS) / 500.0, np.sin(np.arange(ROWS))])
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header="t,x", comments="")
    given = replace(setup(OSCILLATOR, {"x": "x", "force": AT_REST}), path=str(tmp_path / "a.csv"))
    assert missing_choices(given) == []
    source, _ = build_sources(compose(setup_overrides(given), registry()), registry())
    (record,) = source.load(registry().make("system", "oscillator"))
    assert not record.inputs["force"].any()

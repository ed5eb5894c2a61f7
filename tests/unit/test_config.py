"""The configuration: presets, groups, values from a shell, and what is refused."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spiral.io.config import build_problem, compose, experiments
from spiral.io.overrides import expand_sweep
from spiral.io.problem_setup import split_records
from spiral.io.registry import load_registry
from spiral.types.errors import ConfigError, InputError, SpiralError
from spiral.types.record import Record, split_off_test, usual_test_share
from spiral.view.terminal.preview import describe_records, quiet_test_warning

REGISTRY = load_registry()
ROTOR = ("experiment=rotor_coastdown", "record.duration=1")


def composed(*overrides):
    return compose(overrides, REGISTRY)


def refused(*overrides):
    with pytest.raises(SpiralError) as caught:
        compose(overrides, REGISTRY)
    return caught.value


@pytest.fixture
def own_file(tmp_path):
    rng = np.random.default_rng(0)
    rows = np.column_stack([0.01 * np.arange(300), rng.normal(size=(300, 2))])
    path = tmp_path / "own.csv"
    np.savetxt(path, rows, delimiter=",", header="t,ch1,f", comments="")
    return str(path)


def own(path, *more):
    return (
        "system=oscillator", "record=csv", f"record.path={path}", "record.time=t",
        "record.channels={x: ch1}", "record.inputs={force: f}", *more,
    )  # fmt: skip


@pytest.mark.parametrize("name", experiments())
def test_every_preset_composes_and_names_what_is_there(name):
    config = composed(f"experiment={name}")
    for group, kind in (("system", "system"), ("record", "source"), ("test", "source")):
        section = config[group]
        if group == "test" and section["name"] is None:
            continue  # a preset for estimate, or one whose record's end is the test
        known = REGISTRY.entry(kind, section["name"]).plugin.__dataclass_fields__
        assert set(section) - {"name", "settle"} <= set(known)


def test_presets_are_the_papers_two_scenarios():
    table, text = (
        composed("experiment=rotor_coastdown"),
        composed("experiment=rotor_coastdown_text"),
    )
    assert [table["record"][k] for k in ("duration", "start_hz", "stop_hz")] == [14.0, 40.0, 0.0]
    assert [text["record"][k] for k in ("duration", "start_hz", "stop_hz")] == [8.0, 60.0, 5.0]
    assert composed("experiment=rotor_coastdown_settled")["record"]["settled"] is True


def test_a_configuration_is_the_callers_own():
    """A preset is composed once; who changes what was given changes nothing for the next."""
    composed(*ROTOR)["record"]["seed"] = 12
    assert composed(*ROTOR)["record"]["seed"] == 11


def test_a_list_of_columns_names_each_as_it_is():
    fields = {"path": "a.csv", "inputs": ["force"]}
    assert REGISTRY.make("source", "csv", fields).inputs == {"force": "force"}
    with pytest.raises(ConfigError, match="a mapping"):
        REGISTRY.make("source", "csv", {**fields, "inputs": 3})


def test_a_problem_is_built_with_records_test_and_candidates():
    problem = build_problem(composed(*ROTOR, "settings.max_rounds=2"), REGISTRY)
    assert problem.model.labels == ("linear_stiffness", "linear_damping", "unbalance")
    assert {"gyroscopic", "cross_stiffness"} <= {e.label for e in problem.candidates}
    assert not {e.label for e in problem.candidates} & set(problem.model.labels)
    assert problem.settings.max_rounds == 2
    (record,), (test,) = problem.records, problem.test
    assert record.samples == test.samples == 1000  # a test's field left out is as the record's
    assert record.sha256 != test.sha256


@pytest.mark.parametrize(
    ("said", "meant"),
    [("off", False), ("none", False), ("no", False), ("false", False), ("on", True)],
)
def test_a_switch_is_turned_by_its_groups_name(said, meant):
    config = composed(*ROTOR, f"tracking={said}")
    assert config["tracking"]["enabled"] is meant
    assert "uri" in config["tracking"]


def test_mappings_lists_and_units_from_a_shell(own_file):
    config = composed(
        *own(own_file), "record.units={x: um}", "record.rows=[10,250]",
        "record.noise={x: 9e-7}", "system.position_unit=mm", "record.units.force=kN",
    )  # fmt: skip
    assert config["record"]["channels"] == {"x": "ch1"}
    assert config["record"]["units"] == {"x": "um", "force": "kN"}
    problem = build_problem(config, REGISTRY)
    assert problem.records[0].samples + problem.test[0].samples == 240
    assert problem.records[0].noise == {"x": 9e-7}
    assert math.isclose(np.std(problem.records[0].channels["x"]), 1e-3, rel_tol=0.3)


def test_a_mapping_replaces_the_presets():
    config = composed("experiment=silverbox", "record.channels={x: ch1}")
    assert config["record"]["channels"] == {"x": "ch1"}


def test_the_last_part_is_kept_apart_without_a_test(own_file):
    problem = build_problem(composed(*own(own_file), "holdout=0.25", "test.settle=0.1"), REGISTRY)
    assert (problem.records[0].samples, problem.test[0].samples) == (225, 75)
    assert problem.settle == 0.1


def test_test_path_alone_means_the_same_columns(own_file, tmp_path):
    import shutil

    other = tmp_path / "other.csv"
    shutil.copy(own_file, other)
    config = composed(*own(own_file, "record.rows=[0,100]"), f"test.path={other}")
    problem = build_problem(config, REGISTRY)
    assert problem.records[0].samples == 100
    assert problem.test[0].samples == 300  # rows are the test's own
    assert problem.test[0].name == "other.csv"
    rows = build_problem(composed(*own(own_file), "test.rows=[200,300]"), REGISTRY)
    assert rows.test[0].samples == 100


def test_a_path_alone_means_a_file_of_any_kind(own_file):
    short = composed(*(o for o in own(own_file) if o != "record=csv"))
    assert short["record"]["name"] == "file"
    for part in ("records", "test"):
        one, other = (getattr(build_problem(c, REGISTRY), part)[0]
                      for c in (short, composed(*own(own_file))))  # fmt: skip
        np.testing.assert_array_equal(one.channels["x"], other.channels["x"])


def test_a_simulated_test_has_other_noise():
    config = composed("system=planar_rotor", "record=rotor_coastdown", "record.duration=0.2",
                      "test.phase=1.0")  # fmt: skip
    problem = build_problem(config, REGISTRY)
    noise = [r.channels["x"] - r.truth["x"] for r in (*problem.records, *problem.test)]
    assert not np.allclose(*noise)


def test_groups_keep_the_presets_fields_only_for_the_same_plugin():
    same = composed("experiment=rotor_coastdown", "record=rotor_coastdown")
    assert same["record"]["phase"] == 0.4
    other = composed("experiment=rotor_coastdown", "record=csv", "record.path=a.csv")
    assert "phase" not in other["record"]
    assert composed("experiment=rotor_coastdown", "test=null")["test"]["name"] is None
    assert composed("experiment=rotor_coastdown", "~test")["test"]["name"] is None


def test_effects_by_name_port_and_field():
    config = composed("system=tilting_rotor", "effect=[clearance@bearing_2,crack]",
                      "effect.crack.port=bearing_1")  # fmt: skip
    assert set(config["effect"]) == {"clearance@bearing_2", "crack"}
    assert config["effect"]["crack"] == {"port": "bearing_1"}


def test_the_model_is_the_seed_and_more_or_less():
    def labels(*more):
        config = composed(*ROTOR, *more)
        return build_problem(config, REGISTRY).model.labels

    assert labels("effect=[gyroscopic]")[-1] == "gyroscopic"
    assert labels("without=[unbalance]") == ("linear_stiffness", "linear_damping")
    assert labels("seed=[linear_stiffness]") == ("linear_stiffness",)


def test_values_free_fixed_and_candidates():
    config = composed(
        *ROTOR, "effect=[rub]", "values={rub.gap: 1e-5}", "values.rub.stiffness=3.0",
        "free=[rub.gap]", "fixed=[unbalance.moment]", "candidates=[gyroscopic,rub]",
    )  # fmt: skip
    problem = build_problem(config, REGISTRY)
    assert problem.model.values["rub.stiffness"] == 3.0
    assert "rub.gap" in problem.model.active
    assert "unbalance.moment" not in problem.model.active
    assert [e.label for e in problem.candidates] == ["gyroscopic"]


@pytest.mark.parametrize(
    ("overrides", "near"),
    [
        (("systm=oscillator",), "'system'"),
        (("system=oscilator",), "'oscillator'"),
        (("system=osc",), "'oscillator'"),
        (("experiment=silverbx",), "'silverbox'"),
        (("record=csv", "record.pth=a"), "'path'"),
        (("record=csv", "+record.pth=a"), "'path'"),
        (("record=csv", "++record.pth=a"), "'path'"),
        (("system=oscillator", "system.position=V"), "'position_unit'"),
        (("effect=[cubic_stifness]",), "'cubic_stiffness'"),
        (("effect=[clearance]", "effect.clearance.prt=a"), "'port'"),
        (("effect=[clearance]", "effect.clearnce.port=a"), "'clearance'"),
        (("settings.levl=0.1",), "'level'"),
        ((*ROTOR, "test.sed=1"), "'seed'"),
        (("+nonsense=1",), "one of"),
    ],
)
def test_unknown_names_get_near_misses(overrides, near):
    assert near in refused(*overrides).try_


@pytest.mark.parametrize(
    "overrides",
    [
        ("record.duration=3",),
        ("system.name=oscillator",),
        ("system={name: oscillator}",),
        ("strategy=papr",),
        ("strategy=paper", "gate=3"),
        ("strategy=paper", "gate=[partial]"),
        ("holdout=2",),
        ("holdout=much",),
        ("settings=3",),
        ("settings.level.deep=3",),
        ("free=3",),
        ("values={a: b}",),
        ("record.seed=1,2",),
        ("record.channels={x: ",),
        ("=3",),
        ("effect=3",),
        ("experiment=rotor_coastdown", "record.seed=range(3)"),
    ],
)
def test_values_that_do_not_fit_are_refused(overrides):
    error = refused(*overrides)
    assert error.given
    assert error.expected


@pytest.mark.parametrize(
    ("overrides", "word"),
    [
        ((), "no system"),
        (("system=oscillator",), "no record"),
        (("system=oscillator", "record=csv"), "without a file"),
        (("system=oscillator", "record.duration=3"), "no record is chosen"),
        ((*ROTOR, "without=[gyroscopic]"), "gyroscopic"),
        ((*ROTOR, "effect=[linear_damping]"), "twice"),
        ((*ROTOR, "effect=[cubic_stiffness@bearing_9]"), "bearing_9"),
        ((*ROTOR, "effect=[gravity_torque]"), "gravity_torque"),
        ((*ROTOR, "candidates=[gravity_torque]"), "gravity_torque"),
        ((*ROTOR, "values={rub.gap: 1}"), "rub.gap"),
        ((*ROTOR, "settings.level=2"), "settings.level"),
        ((*ROTOR, "record.seed=a"), "record.seed"),
        ((*ROTOR, "test.settle=-1"), "test.settle"),
    ],
)
def test_problems_that_cannot_be_built(overrides, word):
    with pytest.raises((ConfigError, InputError)) as caught:
        build_problem(composed(*overrides), REGISTRY)
    assert word in caught.value.given


def test_sweeps_expand_in_order():
    assert expand_sweep(("a=1,2", "b=x", "c=[1,2]")) == (
        ("a=1", "b=x", "c=[1,2]"),
        ("a=2", "b=x", "c=[1,2]"),
    )
    assert len(expand_sweep(("record.seed=range(0,5)", "d=1,2"))) == 10


WORDS = st.text("abcdefghijklmnopqrstuvwxyz_.=[]{}:,'\"@+~ 0159-$", max_size=24)


@settings(max_examples=150, deadline=None)
@given(words=st.lists(WORDS, min_size=1, max_size=3))
def test_any_words_give_a_configuration_or_one_clear_message(words):
    error = None
    try:
        compose(("experiment=rotor_coastdown", *words), REGISTRY)
    except SpiralError as caught:
        error = caught
    assert error is None or (error.given and error.expected)


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    level=st.floats(0, 10, allow_nan=False),
    columns=st.dictionaries(
        st.sampled_from("xy"), st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True), min_size=1
    ),
)
def test_values_arrive_as_given(seed, level, columns):
    config = composed(*ROTOR, f"record.seed={seed}", f"record.noise_level={level!r}")
    assert config["record"]["seed"] == seed
    assert config["record"]["noise_level"] == level
    text = ", ".join(f"{k}: '{v}'" for k, v in columns.items())
    own = composed("system=planar_rotor", "record=csv", f"record.channels={{{text}}}")
    assert own["record"]["channels"] == columns


NUMBERS = st.floats(-1e6, 1e6, allow_nan=False)


@settings(max_examples=20, deadline=None)
@given(
    angles=st.fixed_dictionaries({"x": NUMBERS, "y": NUMBERS}),
    low=st.floats(0, 1e3),
    width=st.floats(1, 1e3),
    gap=st.integers(1, 10**6),
    rotation=st.sampled_from(["clockwise", "counterclockwise"]),
    column=st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True),
)
def test_a_rotors_options_arrive_as_given(angles, low, width, gap, rotation, column):
    """From words on a command line to the typed fields of the source."""
    from spiral.io.config import build_sources

    config = composed(
        "system=planar_rotor", "record=csv", f"record.pulse='{column}'",
        f"record.probe_angles={{x: {angles['x']!r}, y: {angles['y']!r}}}",
        f"record.slow_roll={{speed: [{low!r}, {low + width!r}]}}",
        f"record.fill_gaps={gap}", f"record.rotation={rotation}",
        "test.slow_roll={rows: [0, 9]}", "test.path=b.csv",
    )  # fmt: skip
    source, test = build_sources(config, REGISTRY)
    assert source.probe_angles == test.probe_angles == angles
    assert source.slow_roll == {"speed": [low, low + width]}
    assert test.slow_roll == {"rows": [0, 9]}
    assert (source.fill_gaps, source.rotation, source.pulse) == (gap, rotation, column)


def test_a_share_is_kept_apart_from_each_of_several_blocks(own_file):
    whole = build_problem(composed(*own(own_file, "holdout=0.2")), REGISTRY)
    with pytest.raises(InputError, match="300 samples in 5 blocks"):
        build_problem(composed(*own(own_file, "holdout_blocks=5")), REGISTRY)
    assert "a whole number" in refused("holdout_blocks=0").expected
    record = whole.records[0]
    time = 0.01 * np.arange(1440)
    long = replace(record, time=time, channels={"x": time}, inputs={"force": time}, spoilt={})
    blocks = split_records((long,), None, 0.2, 5)
    assert [sum(r.samples for r in part) for part in blocks] == [1150, 290]
    assert [r.name.split(" (", 1)[1] for r in blocks[1]] == [
        f"block {k} of 5) (last 20%, kept apart)" for k in range(1, 6)
    ]


@pytest.mark.parametrize(("decay", "blocks", "said"), [(1.0, 1, True), (1.0, 5, False),
                                                       (0.0, 1, False)])  # fmt: skip
def test_a_test_record_that_misses_what_was_excited_is_told(own_file, decay, blocks, said):
    """A run-down whose end is quiet; the same in blocks; a steady motion."""
    problem = build_problem(composed(*own(own_file)), REGISTRY)
    record = problem.records[0]
    time = 0.01 * np.arange(2000)
    moving = np.exp(-decay * time / 5) * np.sin(9 * time)
    long = replace(record, time=time, channels={"x": moving}, inputs={"force": 0 * time}, spoilt={})
    fitted, test = split_records((long,), None, 0.2, blocks)
    warning = quiet_test_warning(describe_records(replace(problem, records=fitted, test=test)))
    assert ("misses what was excited" in warning) is said
    assert ("holdout_blocks=5" in warning) is said


@pytest.mark.parametrize(
    ("still_from", "share"), [(1.0, 0.2), (0.85, 0.4), (0.78, 0.5), (0.6, 0.2)]
)
def test_a_machine_that_comes_to_rest_is_tested_where_it_still_moves(still_from, share):
    """The second half of what is kept apart moves; a fifth where no share has it so."""
    time = 0.01 * np.arange(2000)
    moving = np.where(time < 20 * still_from, np.sin(9 * time), 0.0)
    record = Record("lift", time, {"x": moving}, {})
    assert usual_test_share(record) == share
    fitted, test = split_off_test(record)
    assert test.samples == round(share * 2000) == 2000 - fitted.samples
    assert f"last {share:.0%}, kept apart" in test.name
    assert split_off_test(record, 0.1)[1].samples == 200

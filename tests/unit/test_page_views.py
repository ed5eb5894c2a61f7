"""What a link opens, what a message offers, and figures of several models on one record."""

from dataclasses import replace

import numpy as np
import pytest
from spiral_plugins.systems.oscillator import Oscillator

from spiral.app.address import Address, format_address, parse_address
from spiral.app.caveats import tellable_noise_floor, turn_caveats
from spiral.app.record_setup import advised_lines, replace_line
from spiral.app.side_by_side import comparison_errors, comparison_parameters
from spiral.app.study import StudyState, add_turn, new_study
from spiral.inference.discover import Checkpoint
from spiral.inference.likelihood.departures import reversed_sign_sentences
from spiral.inference.problem import Settings
from spiral.io.curves import FINAL, Curves
from spiral.io.readers.own_units import conversion_to_system, unit_field
from spiral.types.errors import InputError
from spiral.types.model import seed_model
from spiral.types.record import make_record
from spiral.types.run import Comparison, Round
from spiral.view.report.overlay import overlay_models
from spiral.view.report.trial import residual_comparison
from spiral.view.report.unknown import force_loops
from tests.scenes import registry

VIEW = {"xaxis.range[0]": 8.125, "xaxis.range[1]": 9.5}


def query(text):
    """The parts of an address by name, as a server hands them over."""
    from urllib.parse import parse_qsl

    return dict(parse_qsl(text.removeprefix("?")))


def test_an_address_says_what_is_looked_at_and_is_read_back():
    at = Address(3, "Where it fails", {"free_run": VIEW}, (0, 3))
    assert parse_address(**query(format_address(at))) == at


@pytest.mark.parametrize(
    "zoom",
    [
        "free_run.xaxis:1:nan",
        "free_run.xaxis:1:1e999",
        "a.b.xaxis:1:2",
        "free_run.xaxis:1",
        "x" * 9,
    ],
)
def test_what_an_address_cannot_mean_is_left_out(zoom):
    """Ranges that are no finite numbers, other names, other shapes."""
    assert parse_address("-1", "", zoom, "a,,7,1e3") == Address(beside=(7,))


def test_settings_that_a_message_tells_to_try_are_offered_but_no_word_that_stands_for_one():
    said = "record.resample=299.9 makes the steps even; record.rate=SAMPLES_PER_SECOND"
    assert advised_lines({"try": said}) == ["record.resample=299.9"]
    assert advised_lines({"try": "x, system.torque_unit='N*m'."}) == ["system.torque_unit='N*m'"]
    assert advised_lines(None) == []
    assert replace_line("a=1\nrecord.rate=3\n", "record.rate=4") == "a=1\nrecord.rate=4"


def test_a_unit_of_another_dimension_names_the_field_that_sets_the_systems_own():
    known = registry()
    machine = known.make("system", "oscillator")
    with pytest.raises(InputError, match=r"system\.force_unit='V'"):
        conversion_to_system("V", machine, "force")
    with pytest.raises(InputError) as refused:
        conversion_to_system("blorps", machine, "force")
    assert "force_unit" not in str(refused.value)  # no unit at all
    in_volts = known.make("system", "oscillator", {"force_unit": "V"})
    assert conversion_to_system("mV", in_volts, "force")[0] == pytest.approx(1e-3)
    assert conversion_to_system("ms", machine, "time") == pytest.approx((1e-3, 0.0))
    assert unit_field(known.make("system", "tilting_rotor"), "speed") == ""


def curves(free):
    """A record of two seconds whose reading is a sine, with a free run."""
    time = np.arange(1000) / 500.0
    y = np.sin(7 * time)[:, None]
    about = {"part": "test", "start": 0.0, "dt": 1 / 500.0, "samples": 1000, "settled": 100,
             "sigma": {"x": 0.01}}  # fmt: skip
    meta = {"records": [about], "channels": [{"name": "x", "unit": "m"}], "models": {FINAL: {}}}
    return Curves(meta, {"0.y": y, f"0.{FINAL}.free": free(y)})


def test_the_error_of_a_part_of_the_record_is_its_rms():
    """A constant miss of 0.2 has that rms everywhere; a model that is exact has none."""
    figure = residual_comparison(curves(lambda y: y + 0.2), curves(lambda y: y.copy()))
    by_name = {t.name: np.asarray(t.y) for t in figure.data if t.name}
    assert by_name["without it"] == pytest.approx(200.0)  # mm
    assert by_name["with it"] == pytest.approx(0.0, abs=1e-9)
    assert figure.data[-1].x[0] > 0.2  # what settles is not scored
    assert residual_comparison(curves(lambda y: y * np.nan), curves(lambda y: y)) is None


def test_models_on_one_record_stand_over_one_measurement():
    one, other = curves(lambda y: y), curves(lambda y: 0.5 * y)
    lost = curves(lambda y: np.full_like(y, np.inf))
    figure = overlay_models([("one", one), ("other", other), ("lost", lost)])
    assert [t.name for t in figure.data if t.showlegend] == ["measured", "one", "other"]
    residual = next(t for t in figure.data if t.name == "other" and not t.showlegend)
    assert np.max(np.abs(residual.y)) == pytest.approx(500.0, rel=1e-3)  # mm
    dense = overlay_models([("one", one)], (0.5, 0.6)).data[0].x
    assert np.sum((np.asarray(dense) >= 0.5) & (np.asarray(dense) <= 0.6)) >= 50
    assert overlay_models([("lost", lost)]) is None


def test_a_loop_is_one_path_whose_two_colours_meet_where_the_motion_turns():
    angle = np.linspace(0.3, 4 * np.pi, 300)
    found = {"axis": "x", "position": np.sin(angle), "force": np.cos(angle)}
    figure = force_loops({"memory": {"loops": [found], "position_unit": "m", "unit": "N"}})
    grows, falls = figure.data[:2]
    steps = [np.diff(np.asarray(t.x)) for t in (grows, falls)]
    assert np.nanmin(steps[0]) > 0 > np.nanmax(steps[1])
    drawn = sum(np.isfinite(s).sum() for s in steps)
    assert drawn == len(angle) - 1  # no step is left out, none is drawn twice


def test_steps_side_by_side_have_a_column_each(tmp_path):
    study = new_study(tmp_path, "two", ())
    for name, error, estimate in (("", 0.5, 2.0), ("cubic_stiffness", 0.1, 3.0)):
        effects = {
            "linear_stiffness": {"stiffness": {"estimate": estimate, "se": 0.1, "unit": "N/m"}}
        }
        if name:
            effects[name] = {"stiffness": {"estimate": 7.0, "se": 1.0, "unit": "N/m^3"}}
        unseen = [{"horizon": "free_run", "seconds": None, "error": error}]
        result = {
            "test_error": error, "fit_error": error, "unseen": unseen, "chi2_per_dof": 1.0,
            "channels": {"x": {"relative": error}}, "model": {"effects": effects},
        }  # fmt: skip
        study = add_turn(study, StudyState(study.serials + len(study.turns), name, result))
    told = comparison_errors(study, study.turns)
    assert "the model as it was" in told
    assert "<b>10.0 %</b>" in told
    assert "<b>50.0 %</b>" not in told
    assert "1.00" in told
    assert (
        comparison_parameters(study, study.turns).count("<td class='n'>-</td>") == 1
    )  # in one model alone


def test_a_step_s_caveats_name_what_only_looks_random_and_what_contradicts_it():
    comparison = Comparison(
        seed_model(Oscillator()), 0.02, 0.02, {}, 0.02, 1.0, 0.4, 0.0, 1024, True,
        random={"force.observed": 0.05}, disturbed=0.4, contradictions=("c turned its sign",),
    )  # fmt: skip
    at = Checkpoint((Round(0, (), {}, {}, (), comparison, 1.0),), None)
    said = turn_caveats(at, Settings())
    assert "C turned its sign." in said
    assert any(s.startswith("Random forces move a free run by 40.0 %") for s in said)
    calm = Checkpoint((Round(0, (), {}, {}, (), replace(comparison, disturbed=0.01), 1.0),), None)
    assert not any("andom" in s for s in turn_caveats(calm, Settings()))


def test_a_sign_that_also_turned_is_told_once():
    model = seed_model(Oscillator())
    key = "linear_damping.damping"
    model = replace(model, values={**model.values, key: -3.0}, errors={key: 0.1})
    turned = reversed_sign_sentences(model, {key: 3.0})
    comparison = Comparison(
        model, 0.02, 0.02, {}, 0.02, 1.0, 0.4, 0.0, 1024, True, contradictions=turned
    )

    def signs(comparison):
        at = Checkpoint((Round(0, (), {}, {}, (), comparison, 1.0),), None)
        return [s for s in turn_caveats(at, Settings()) if "negative damping" in s]

    assert len(turned) == 1
    assert len(signs(comparison)) == 1
    assert "ended at -3 where 3 was given" in signs(comparison)[0]
    assert len(signs(replace(comparison, contradictions=()))) == 1


def test_a_noise_floor_below_the_rounding_of_the_file_is_not_told():
    rng, time = np.random.default_rng(0), np.arange(2000) / 100.0
    smooth = np.sin(time) + rng.normal(size=2000) * 1e-3
    step = 0.01
    rounded = make_record(
        Oscillator(), "r", time, {"x": step * np.round(smooth / step)}, {"force": smooth}
    )
    least = step / 12**0.5 / smooth.std()
    assert tellable_noise_floor(0.9 * least, [rounded]) is None
    assert tellable_noise_floor(1.1 * least, [rounded]) == 1.1 * least
    fine = make_record(Oscillator(), "s", time, {"x": smooth}, {"force": smooth})
    assert tellable_noise_floor(1e-4, [fine]) == 1e-4
    assert tellable_noise_floor(1e-6, [fine]) is None

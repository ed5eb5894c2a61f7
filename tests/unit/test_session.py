"""The session of the page: two tabs stay one, nothing is lost, whatever the processes do."""

import json

import pytest

from spiral.app import session as sessions
from spiral.app import study as kept
from spiral.app.frame import shell_command
from spiral.app.panels import (
    effect_chips,
    ending_message,
    has_learnable_curve,
    progress_words,
    proposal_message,
)
from spiral.app.record_setup import guess_columns
from spiral.app.session import Session
from spiral.types.errors import ConfigError, InputError
from tests.described_systems import OSCILLATOR, ROTOR

RANKED = {"candidates": [{"effect": "b"}], "proposed": ["b"], "verdict": "effect_missing"}


class Idle:
    """A process that takes orders and does nothing."""

    def __init__(self, kind, out, on_event):
        self.kind, self.orders, self.on_event = kind, [], on_event

    def give(self, order):
        self.orders.append(order)

    def cancel(self, study):
        self.on_event(self.orders[-1], "cancelled", {})

    def close(self):
        """Nothing to end."""


@pytest.fixture
def session(tmp_path, monkeypatch):
    monkeypatch.setattr(sessions, "Process", Idle)
    return Session(tmp_path)


def turned(session, added, error, retired=()):
    """The process answers the last order with a turn and its ranking."""
    fits = session._fits
    order = fits.orders[-1]
    figures = {"test_error": error, "fit_error": error, "admitted": [added] if added else [],
               "retired": list(retired)}  # fmt: skip
    fits.on_event(order, "turn", {"added": added, "result": figures, "noise_floor": 0.01})
    fits.on_event(order, "ranked", RANKED)
    fits.on_event(order, "done", {})
    tried(session)


def tried(session, **preview):
    """The process answers the trial of what was proposed."""
    fits = session._fits
    order = fits.orders[-1]
    assert order["do"] == "preview"
    said = {"effect": order["effect"], "test_error": 0.1, "changes": [], **preview}
    fits.on_event(order, "preview", {"preview": said})
    fits.on_event(order, "done", {})


@pytest.fixture
def ident(session):
    name = session.create("a rotor", ("experiment=rotor_coastdown",))
    turned(session, "", 0.6)
    return name


def errors(study):
    return [t.result["test_error"] for t in study.line]


def test_add_undo_redo_and_another_branch(session, ident):
    serial = session.scene(ident).study.turn.serial
    session.add(ident, "b", serial)
    turned(session, "b", 0.3)
    study = session.scene(ident).study
    assert errors(study) == [0.6, 0.3]
    second = study.turn.serial
    session.move(ident, serial, second)
    assert errors(session.scene(ident).study) == [0.6]
    session.move(ident, second, serial)
    assert errors(session.scene(ident).study) == [0.6, 0.3]
    session.move(ident, serial, second)
    session.add(ident, "c", serial)
    turned(session, "c", 0.2)
    study = session.scene(ident).study
    assert errors(study) == [0.6, 0.2]
    assert [t.added for t in study.after(serial)] == ["b", "c"]  # the first branch is not lost
    session.move(ident, second, study.turn.serial)
    assert errors(session.scene(ident).study) == [0.6, 0.3]
    assert kept.load_study(session.out, ident) == session.scene(ident).study


def test_scores_are_shown_until_the_ranking_is_there_and_only_for_their_turn(session, ident):
    fits = session._fits
    session.add(ident, "b", session.scene(ident).study.turn.serial)
    order, scored = fits.orders[-1], {"candidates": [{"effect": "c"}]}
    fits.on_event(order, "scored", scored)  # of the turn before, ranked again to add to it
    assert session.scene(ident).scored == ()
    landed = {"added": "b", "result": {"test_error": 0.3}, "noise_floor": 0.01}
    fits.on_event(order, "turn", landed)
    fits.on_event(order, "scored", scored)
    assert [c["effect"] for c in session.scene(ident).scored] == ["c"]
    fits.on_event(order, "ranked", RANKED)
    fits.on_event(order, "done", {})
    assert session.scene(ident).scored == ()


def test_a_step_says_how_long_the_last_of_its_kind_took(session, ident):
    session.add(ident, "b", session.scene(ident).study.turn.serial)
    assert session.scene(ident).busy.lasted == 0.0
    turned(session, "b", 0.3)
    session._lasted[ident, "add"] = 14.2
    session.add(ident, "c", session.scene(ident).study.turn.serial)
    busy = session.scene(ident).busy
    said = progress_words(busy.what, "drawing", busy.lasted)
    assert said == "Adding c: drawing (the last such step took 14 s)"
    assert progress_words("Adding c", "", 0.3) == "Adding c"
    words = "refitting with coulomb_friction (9 of 9)"
    assert progress_words("Adding c", words, 0.3) == f"Adding c: {words.replace('_', ' ')}"


def test_turns_of_older_files_are_a_line(session, ident, tmp_path):
    session.add(ident, "b", session.scene(ident).study.turn.serial)
    turned(session, "b", 0.3)
    file = kept.study_folder(tmp_path, ident) / kept.FILE
    data = json.loads(file.read_text())
    for turn in data["turns"]:
        del turn["parent"]
    file.write_text(json.dumps(data))
    assert errors(kept.load_study(tmp_path, ident)) == [0.6, 0.3]


def test_what_is_proposed_is_tried_before_it_is_recommended(session, ident):
    """Nothing is known yet, then not worse, then worse at one horizon; another ranking forgets."""
    session.preview(ident, "b", session.scene(ident).study.turn.serial)
    worse = {"horizon": "ahead", "seconds": 0.1, "judged": "worse", "before": 0.1, "after": 0.2}
    tried(session, changes=[{**worse, "judged": "same"}])
    assert proposal_message(session.scene(ident).study.turn)[1] == "fine"
    session.preview(ident, "b", session.scene(ident).study.turn.serial)
    tried(session, changes=[worse])
    said, kind = proposal_message(session.scene(ident).study.turn)
    assert kind == "worse"
    assert "0.1 s ahead" in said
    session.rank(ident, session.scene(ident).study.turn.serial)
    session._fits.on_event(session._fits.orders[-1], "ranked", RANKED)
    assert proposal_message(session.scene(ident).study.turn)[1] == "trying"
    session._fits.on_event(session._fits.orders[-1], "done", {})
    assert session._fits.orders[-1]["do"] == "preview"
    session.cancel(ident)
    scene = session.scene(ident)
    assert (proposal_message(scene.study.turn)[1], scene.busy) == ("trying", None)
    assert errors(scene.study) == [0.6]  # the turn itself stays


def test_an_effect_that_was_let_go_is_no_part_of_the_model(session, ident, tmp_path):
    for effect, retired in (("b", []), ("c", ["b"]), ("b", [])):
        session.add(ident, effect, session.scene(ident).study.turn.serial)
        turned(session, effect, 0.3, retired)
        study = session.scene(ident).study
        model = {"b": ["b"], "c": ["c"]}[effect] if not retired else ["c"]
        model = ["c", "b"] if len(study.turns) == 4 else model
        assert list(study.added) == model
        assert list(study.gone) == (["b"] if retired else [])
        assert shell_command(study).startswith(f"spiral add {' '.join(model)} ")
        assert ("Removed: b" in effect_chips(study)) is bool(retired)
        assert effect_chips(study).count('"chip added"') == len(model)


def test_a_tab_that_is_behind_changes_nothing(session, ident):
    """Two tabs click Add on the same turn: the second is told, and the first's effect stands."""
    serial = session.scene(ident).study.turn.serial
    session.add(ident, "b", serial)
    with pytest.raises(ConfigError, match="a click while"):
        session.add(ident, "c", serial)
    turned(session, "b", 0.3)
    with pytest.raises(ConfigError, match="another tab"):
        session.add(ident, "c", serial)
    assert [t.added for t in session.scene(ident).study.turns] == ["", "b"]


@pytest.mark.parametrize("how", ["cancelled", "failed"])
def test_what_fails_or_is_cancelled_leaves_the_study_as_it_was(session, ident, how):
    serial = session.scene(ident).study.turn.serial
    session.add(ident, "b", serial)
    told = {"given": "a fit that diverges", "expected": "one that does not", "try": "another"}
    session._fits.on_event(session._fits.orders[-1], how, told if how == "failed" else {})
    scene = session.scene(ident)
    assert (errors(scene.study), scene.busy) == ([0.6], None)
    said = scene.study.trouble["given"]
    assert said == (told["given"] if how == "failed" else "Cancelled: adding b")
    assert scene.study.trouble["at"] == ("add" if how == "failed" else "cancelled")
    session.add(ident, "b", serial)
    assert session.scene(ident).study.trouble is None


def test_cancelling_what_has_landed_takes_it_back(session, ident):
    """The refit is there, its ranking is not: the study is as it was before the click."""
    serial = session.scene(ident).study.turn.serial
    session.add(ident, "b", serial)
    order = session._fits.orders[-1]
    landed = {"added": "b", "result": {"test_error": 0.3}, "noise_floor": 0.01}
    session._fits.on_event(order, "turn", landed)
    assert errors(session.scene(ident).study) == [0.6, 0.3]
    session.cancel(ident)
    assert errors(session.scene(ident).study) == [0.6]
    assert session.scene(ident).study.turn.serial == serial


def test_a_first_fit_whose_ranking_was_cancelled_can_be_ranked(session):
    ident = session.create("a rotor", ())
    order = session._fits.orders[-1]
    landed = {"added": "", "result": {"test_error": 0.6}, "noise_floor": 0.01}
    session._fits.on_event(order, "turn", landed)
    session.cancel(ident)
    turn = session.scene(ident).study.turn
    assert turn.candidates is None
    session.rank(ident, turn.serial)
    session._fits.on_event(session._fits.orders[-1], "ranked", RANKED)
    assert session.scene(ident).study.turn.proposed == ("b",)
    assert session._writer.orders[-1]["serial"] == turn.serial


def test_another_start_finds_the_study_where_it_was(session, ident, tmp_path):
    session.add(ident, "b", session.scene(ident).study.turn.serial)
    turned(session, "b", 0.3)
    again = Session(tmp_path)
    assert again.scene(ident).study == session.scene(ident).study
    assert [s.ident for s in again.studies()] == [ident]


def test_every_turn_is_written_down_once(session, ident):
    session.add(ident, "b", session.scene(ident).study.turn.serial)
    turned(session, "b", 0.3)
    orders = session._writer.orders
    assert [o["do"] for o in orders] == ["write", "write"]
    assert [o["serial"] for o in orders] == [t.serial for t in session.scene(ident).study.turns]
    session._writer.on_event(orders[0], "saved", {"run_id": "20260101-000000-abc"})
    assert session.scene(ident).study.turns[0].run_id == "20260101-000000-abc"
    assert session.scene(ident).study.turns[1].run_id == ""


def test_a_turn_that_was_not_written_down_is_caught_up_with(session, ident, tmp_path):
    """The program ended between a turn and its saved run: the next start writes it."""
    session.add(ident, "b", session.scene(ident).study.turn.serial)
    turned(session, "b", 0.3)
    first = session._writer.orders[0]
    session._writer.on_event(first, "saved", {"run_id": "20260101-000000-abc"})
    again = Session(tmp_path)
    last = session.scene(ident).study.turn.serial
    assert again.scene(ident).writing == (last,)
    assert [(o["do"], o["serial"]) for o in again._writer.orders] == [("write", last)]


def test_a_formula_becomes_an_override_with_the_values_of_its_widths(session, ident):
    serial = session.scene(ident).study.turn.serial
    session.invent(ident, "rubbing", "-F*tanh(v/w)", serial, "w=0.01, g = 2e-4")
    order = session._fits.orders[-1]
    assert order["overrides"][1:] == [
        "effect.rubbing.expression='-F*tanh(v/w)'", "effect.rubbing.shape={w: 0.01, g: 0.0002}"
    ]  # fmt: skip
    session._fits.on_event(order, "ranked", RANKED)
    session._fits.on_event(order, "done", {})
    tried(session)
    session.invent(ident, "rubbing", "-F*v", serial)
    assert session._fits.orders[-1]["overrides"][1:] == ["effect.rubbing.expression='-F*v'"]


def test_curves_are_offered_where_nothing_with_a_name_passes(session, ident):
    fits = session._fits
    session.rank(ident, session.scene(ident).study.turn.serial)
    nothing = {**RANKED, "proposed": [], "verdict": "no_candidate", "shape": "A force: smooth."}
    fits.on_event(fits.orders[-1], "ranked", nothing)
    fits.on_event(fits.orders[-1], "done", {})
    study = session.scene(ident).study
    assert has_learnable_curve(study, study.turn)
    assert ending_message(study, study.turn).endswith("What is left: a force: smooth.")
    session.learn(ident, study.turn.serial)
    order = fits.orders[-1]
    assert order["overrides"] == ["experiment=rotor_coastdown", "settings.learned=true"]
    fits.on_event(order, "ranked", {**RANKED, "proposed": ["learned_spring"]})
    fits.on_event(order, "done", {})
    study = session.scene(ident).study
    assert study.overrides[-1] == "settings.learned=true"
    assert study.own == ()
    assert not has_learnable_curve(study, study.turn)


def test_a_name_as_one_types_it_becomes_the_name_of_an_effect(session, ident):
    session.invent(ident, " Fifth-power spring", "-k5*q**5", session.scene(ident).study.turn.serial)
    assert session._fits.orders[-1]["name"] == "fifth_power_spring"


PENDULUM = {
    "name": "pendulum",
    "channels": [{"name": "theta", "unit": "rad"}],
    "inputs": [{"name": "torque", "unit": "rad/s^2", "required": True}],
}


@pytest.mark.parametrize(
    ("system", "columns", "time", "chosen", "units"),
    [
        (ROTOR, {"t_ms": "", "probeX_um": "", "probeY_um": "", "n_rpm": ""}, "t_ms",
         {"x": "probeX_um", "y": "probeY_um", "speed": "n_rpm"},
         {"time": "ms", "x": "um", "y": "um", "speed": "rpm"}),
        (ROTOR, {"y": "", "x": "", "speed": "", "time": ""}, "time",
         {"x": "x", "y": "y", "speed": "speed"}, {}),
        (OSCILLATOR, {"Zeit [ms]": "ms", "Kraft [N]": "N", "Weg [mm]": "mm"}, "Zeit [ms]",
         {"force": "Kraft [N]", "x": "Weg [mm]"}, {}),
        (OSCILLATOR, {"a": "", "b": ""}, "", {"x": "a"}, {}),
        (OSCILLATOR, {"t": "s", "angle": "deg", "u": "V"}, "t", {}, {}),
        (OSCILLATOR, {"t": "s", "angle_rad": "", "load": "kN", "disp": "mm"}, "t",
         {"x": "disp", "force": "load"}, {}),
        (PENDULUM, {"t": "s", "angle": "", "voltage": ""}, "t", {"theta": "angle"}, {}),
    ],
)  # fmt: skip
def test_columns_are_guessed_by_name_and_by_unit(system, columns, time, chosen, units):
    listed = [{"name": name, "unit": unit} for name, unit in columns.items()]
    found = guess_columns(listed, system)
    assert (found.time, dict(found.columns), dict(found.units)) == (time, chosen, units)


@pytest.mark.parametrize("shape", ["w", "w=wide", "w=nan", "0.1", "a b=1", "w={x: 1}"])
def test_a_width_that_is_no_number_is_refused(session, ident, shape):
    with pytest.raises(ConfigError, match="NAME=NUMBER"):
        session.invent(
            ident, "rubbing", "-F*tanh(v/w)", session.scene(ident).study.turn.serial, shape
        )
    assert session.scene(ident).busy is None


@pytest.mark.parametrize("name", ["../../etc", "a/b", "nosuchstudy", "", "20260101-000000-0abc"])
def test_only_studies_have_pages(session, name):
    with pytest.raises(ConfigError):
        session.scene(name)


def test_a_damaged_study_says_so_and_hides_no_other(session, ident, tmp_path):
    other = session.create("another", ("experiment=rotor_coastdown",))
    file = kept.study_folder(tmp_path, ident) / kept.FILE
    file.write_text(json.dumps({"ident": ident}))
    assert [s.ident for s in kept.list_studies(tmp_path)] == [other]
    with pytest.raises(InputError, match="a study saved by this program"):
        kept.load_study(tmp_path, ident)

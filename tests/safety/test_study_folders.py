"""A folder of studies from anywhere: its texts stay texts, and it names nothing that is run."""

import json
import re
from dataclasses import asdict, replace
from html.parser import HTMLParser

import pytest

from spiral.app import horizon_errors, panels
from spiral.app import record_setup as drafts
from spiral.app import session as sessions
from spiral.app import study as kept
from spiral.app.downloads import add_download_routes, write_download
from spiral.app.run_writer import RunWriter
from spiral.app.session import Session
from spiral.app.study import StudyState
from spiral.io.mathml import mathml
from spiral.io.storage import run_folder, save_result
from spiral.io.tracking.track import TrackingResult
from spiral.types.errors import ConfigError, InputError
from spiral.view.report import evidence, text
from spiral.view.report.html import ReportFigure, single_figure_page
from spiral.view.report.markup import safe_mathml
from tests.exported import REGISTRY, machine_of
from tests.unit.test_session import Idle

EVIL = "\"'><img src=x onerror=alert(1)></script><script>alert(2)</script>`${alert(3)}`"


class Elements(HTMLParser):
    """Every element that a browser would make of a text, and every attribute."""

    def __init__(self, html):
        super().__init__()
        self.tags, self.attributes = [], []
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, *pair) for pair in attrs]


def harmless(html):
    """Whether a text makes nothing that runs, fetches, links or embeds."""
    seen = Elements(html)
    running = {"script", "img", "iframe", "object", "embed", "link", "svg", "a", "form", "meta"}
    named = {name for _, name, _ in seen.attributes}
    return not running & set(seen.tags) and not any(n.startswith("on") for n in named)


@pytest.fixture
def session(tmp_path, monkeypatch):
    monkeypatch.setattr(sessions, "Process", Idle)
    return Session(tmp_path)


@pytest.fixture
def ident(session):
    return session.create("a rotor", ("experiment=rotor_coastdown",))


def rewritten(session, ident, /, **values):
    """The study as somebody else's file has it, in a page that starts anew."""
    file = kept.study_folder(session.out, ident) / kept.FILE
    file.write_text(json.dumps({**json.loads(file.read_text()), **values}))
    return Session(session.out, session.plugins)


def plain_turn(**values):
    turn = StudyState(0, result={"test_error": 0.5}, candidates=(), verdict="no_candidate")
    return asdict(replace(turn, **values))


@pytest.mark.hostile("study folders")
def test_a_plugin_folder_that_a_study_names_is_never_loaded(session, ident, tmp_path):
    """``plugins`` in study.json was executed when the page opened it."""
    again = rewritten(session, ident, plugins=str(tmp_path / "evil"), turns=[plain_turn()])
    serial = again.scene(ident).study.turn.serial
    again.add(ident, "b", serial)
    orders = [*again._fits.orders, *again._writer.orders]
    assert orders
    assert {o["plugins"] for o in orders} == {None}
    assert "plugins" not in asdict(again.scene(ident).study)


@pytest.mark.hostile("study folders")
def test_a_study_is_called_by_its_folder(session, ident):
    again = rewritten(session, ident, ident="<script>")
    assert again.scene(ident).study.ident == ident
    assert [s.ident for s in again.studies()] == [ident]


@pytest.mark.hostile("study folders")
@pytest.mark.parametrize("serial", ["../../elsewhere", "x", None, [1]])
def test_the_number_of_a_turn_is_a_number(session, ident, serial):
    """It becomes part of a folder's name."""
    again = rewritten(session, ident, turns=[{**plain_turn(), "serial": serial}])
    with pytest.raises(InputError, match="a study saved by this program"):
        again.scene(ident)


@pytest.mark.hostile("study folders")
@pytest.mark.parametrize(
    "values",
    [{"turns": 5}, {"turns": ["x"]}, {"records": ["x"]}, {"trouble": "x"}, {"noise_floor": EVIL},
     {"turns": [{"serial": 0, "result": {"test_error": EVIL}}]}, {"at": EVIL}],
)  # fmt: skip
def test_a_study_of_other_types_hides_no_other(session, ident, values):
    other = session.create("another", ())
    assert [s.ident for s in rewritten(session, ident, **values).studies()] == [other]


@pytest.mark.hostile("study folders")
def test_a_study_that_is_a_link_elsewhere_is_not_read(session, ident, tmp_path):
    file = kept.study_folder(session.out, ident) / kept.FILE
    file.rename(tmp_path / "study.json")
    file.symlink_to(tmp_path / "study.json")
    with pytest.raises(InputError, match="link out of its folder"):
        kept.load_study(session.out, ident)


@pytest.mark.hostile("study folders")
@pytest.mark.parametrize("run_id", ["../secret", "..", "/etc", "a/b", "-x", ""])
def test_only_files_of_a_run_are_taken_away(session, ident, tmp_path, run_id):
    (tmp_path.parent / "secret").mkdir(exist_ok=True)
    (tmp_path.parent / "secret" / "run.json").write_text("{}")
    again = rewritten(session, ident, turns=[plain_turn(run_id=run_id)])
    with pytest.raises(ConfigError):
        write_download(again, ident, 0, "run.json")


@pytest.mark.hostile("study folders")
def test_a_link_among_a_runs_files_is_not_taken_away(session, ident, tmp_path):
    run = tmp_path / "20260101-000000-abc"
    run.mkdir()
    (tmp_path / "secret").write_text("secret")
    (run / "run.json").symlink_to(tmp_path / "secret")
    again = rewritten(session, ident, turns=[plain_turn(run_id=run.name)])
    with pytest.raises(InputError, match="link out of its folder"):
        write_download(again, ident, 0, "run.json")


@pytest.mark.hostile("study folders")
@pytest.mark.parametrize(
    ("name", "own"), [("model.py", "PARAMETERS"), ("report.html", "<title>spiral")]
)
def test_a_program_that_lies_in_a_runs_folder_is_not_taken_away(session, ident, name, own):
    """It may come from anywhere under the name of an export or report; both are made anew."""
    model = replace(machine_of("hysteresis").model, errors={})
    run_id = save_result("discover", {}, model, {}, {}, REGISTRY, session.out)
    (run_folder(session.out, run_id) / name).write_text("<script>a-planted-program</script>")
    again = rewritten(session, ident, turns=[plain_turn(run_id=run_id)])
    text = write_download(again, ident, 0, name).read_text()
    assert "a-planted-program" not in text
    assert own in text


class Asked:
    """Stands for MLflow's page: notes which store it was asked to open."""

    stores = ()

    def address(self, store, place):
        self.stores += (store,)
        return "http://127.0.0.1:1/"


@pytest.mark.hostile("study folders")
@pytest.mark.parametrize(
    ("tracked", "opened"), [("experiments/1/runs/a1", 1), ("../../x", 0), ("//evil.example", 0)]
)
def test_mlflow_opens_the_pages_own_store(session, ident, monkeypatch, tracked, opened):
    """``store`` in study.json was handed to a server, or a browser was sent there."""
    from fastapi import FastAPI
    from fastapi.testclient import TestClient

    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    turn = {**plain_turn(run_id="r", tracked=tracked), "store": "http://evil.example"}
    again, viewer, web = rewritten(session, ident, turns=[turn]), Asked(), FastAPI()
    add_download_routes(web, again, viewer)
    answer = TestClient(web).get(f"/mlflow/{ident}/0", follow_redirects=False)
    assert answer.status_code == (307 if opened else 404)
    assert viewer.stores == (f"sqlite:///{session.out / 'mlflow.db'}",) * opened


@pytest.mark.hostile("study folders")
def test_runs_of_a_study_are_told_to_the_pages_own_store(tmp_path, monkeypatch):
    told = []
    monkeypatch.setattr(
        "spiral.io.tracking.track.track",
        lambda how, *given, **more: told.append(how) or TrackingResult({}),
    )
    writer = RunWriter(tmp_path, lambda kind, data: None)
    writer.config = {"tracking": {"uri": "http://evil.example", "experiment": "mine"}}
    writer._track("r")
    assert (told[0].uri, told[0].experiment) == (None, "mine")


def test_an_address_of_mlflow_typed_on_the_page_is_refused_in_words(session):
    with pytest.raises(ConfigError, match=r"tracking\.uri on the page"):
        session.create("a rotor", ("experiment=rotor_coastdown", "tracking.uri=http://x"))


def test_a_draft_is_called_by_its_folder_and_checked_by_type(tmp_path):
    draft = drafts.new_setup(tmp_path, "a.csv")
    drafts.save_setup(tmp_path, draft)
    assert drafts.load_setup(tmp_path, draft.ident) == draft
    file = drafts.setup_folder(tmp_path, draft.ident) / drafts.FILE
    file.write_text(json.dumps({**asdict(draft), "ident": "../.."}))
    assert drafts.load_setup(tmp_path, draft.ident).ident == draft.ident
    file.write_text(json.dumps({**asdict(draft), "columns": "x"}))
    with pytest.raises(ConfigError):
        drafts.load_setup(tmp_path, draft.ident)


# --- texts ---------------------------------------------------------------------------------------

RESULT = {
    "test_error": 0.2, "fit_error": 0.2, "chi2_per_dof": 1.0, "whiteness_p": 0.5, "horizon": 64,
    "channels": {EVIL: {"rmse": 1e-3, "relative": 0.1}}, "advice": EVIL, "stopped": EVIL,
    "verdict": EVIL, "alias_groups": [[EVIL, EVIL]],
    "model": {"effects": {EVIL: {EVIL: {"estimate": 1.0, "se": 0.1, "t": 10.0, "unit": EVIL}}},
              "system": {}},
    "rounds": [{
        "round": i, "admitted": [EVIL], "aliases": {EVIL: [EVIL]}, "rejected": {EVIL: EVIL},
        "retired": [EVIL], "fit_error": 0.1, "test_error": 0.2, "chi2_per_dof": 1.0,
        "whiteness_p": 0.5, "second_order": True,
    } for i in range(2)],
    "suggestions": [{
        "effect": EVIL, "meaning": f"{EVIL}: a = {EVIL}", "aliases": [EVIL], "explains": 0.5,
        "p_value": 0.1, "wald_p_value": 0.1, "test_error_after": 0.1, "statistic": 1.0,
    }],
}  # fmt: skip
EQUATION = [{"left": EVIL, "terms": [{"owner": EVIL, "math": EVIL}]}]
SAVED = {
    "run_id": EVIL, "verb": EVIL, "created": EVIL, "overrides": [EVIL], "result": RESULT,
    "config": {"experiment": EVIL, "system": {"name": EVIL}},
    "plugins": {f"effect/{EVIL}": EVIL},
    "model": {"system": {"name": EVIL}, "effects": [{"name": EVIL}]},
    "data": {EVIL: [{"name": EVIL, "samples": 10, "rate": 1.0, "sha256": EVIL, "notes": [EVIL]}]},
}  # fmt: skip


class Told:
    """Curves whose texts are somebody else's."""

    meta = {
        "models": {"seed": {"where": {"sentence": EVIL}}, "final": {"where": {"sentence": EVIL}}},
        "channels": [{"name": EVIL, "unit": EVIL}],
        "mathml": EQUATION,
    }


CHANGES = [{"horizon": "free_run", "before": 0.1, "after": 0.2, "judged": "worse",
            "standard_error": 0.01}]  # fmt: skip


def shown():
    """Every piece of page and report that is made of texts, by what it is."""
    turn = StudyState(
        0, EVIL, RESULT, tuple(RESULT["suggestions"]), (EVIL,), {EVIL: EVIL}, EVIL, EVIL, EVIL,
        {}, EVIL, tuple(EQUATION), ((EVIL, EVIL, EVIL),), True, EVIL, EVIL, EVIL,
    )  # fmt: skip
    said = {"given": EVIL, "expected": EVIL, "try": EVIL}
    turns = (turn, replace(turn, serial=1))
    study = kept.Study("x", EVIL, (EVIL,), EVIL, turns, 1, 2, said, (), 0.01, (EVIL,))
    series = {"name": EVIL, "unit": EVIL, "lowest": 0.0, "highest": 1.0}
    records = ({"part": EVIL, "samples": 3, "rate": 1.0, "series": [series]},)
    candidate = RESULT["suggestions"][0]
    return {
        "headline": panels.headline(study),
        "chips": panels.effect_chips(study),
        "ending": panels.ending_message(study, turn),
        "astray": panels.divergence_warning(replace(turn, result={})),
        "channels": panels.channel_error_table(turn, {EVIL: EVIL}),
        "model": panels.model_table(turn),
        "candidate": panels.candidate_title(candidate),
        "evidence": panels.candidate_evidence(candidate),
        "alike": panels.indistinguishable_note([EVIL]),
        "trouble": panels.error_message(study.trouble),
        "contrast": panels.contrast_table(
            [{**RESULT["rounds"][0], "effect": EVIL, "unseen": []}], 64
        ),
        "order": panels.ranking_order_note(
            replace(turn, proposed=("b",), candidates=(candidate, {**candidate, "effect": "b"}))
        ),
        "proposal": panels.proposal_message(turn)[0],
        "step": horizon_errors.worse_step_note(replace(turn, result={"changes": CHANGES})),
        "records": panels.records_table(records),
        "meaning": panels.effect_meaning(f"{EVIL}: a = {EVIL}"),
        "header": text.report_header(SAVED, Told),
        "data": text.data_section(SAVED),
        "sentences": text.where_sentences(Told),
        "suggested": text.rounds_or_suggestions(SAVED),
        "ranked": text.rounds_or_suggestions({**SAVED, "result": {**RESULT, "rounds": []}}),
        "equation": text.model_section(SAVED, Told),
        "errors": text.error_table(SAVED, Told),
        "caveats": text.caveat_section(SAVED, Told),
        "reproduce": text.reproduction_section(SAVED),
    }


SHOWN = shown()


@pytest.mark.hostile("study folders")
@pytest.mark.parametrize("name", SHOWN)
def test_a_text_stays_a_text_wherever_it_is_shown(name):
    assert harmless(SHOWN[name])


def test_the_texts_are_shown_at_all():
    """So that the test above cannot pass by showing nothing."""
    silent = {n for n, html in SHOWN.items() if "alert(1)" not in html}
    assert silent <= {"headline", "evidence"}  # which show numbers alone
    assert not harmless(EVIL)


@pytest.mark.hostile("study folders")
def test_a_text_inside_a_figure_ends_no_script():
    figure = evidence.error_falling(RESULT)
    html = single_figure_page(ReportFigure(EVIL[:3], EVIL, EVIL, figure))
    inside = html.rpartition("<body>")[2]
    assert "alert(2)" in inside
    assert "<script>alert(2)" not in inside
    assert len(re.findall("</script>", inside)) == Elements(inside).tags.count("script")


# --- MathML --------------------------------------------------------------------------------------


def test_mathml_of_a_model_comes_through_as_it_was(question):
    found = mathml(question[1].model)
    for piece in (t["math"] for item in found for t in item["terms"]):
        assert Elements(safe_mathml(piece)).tags == Elements(piece).tags
        assert re.sub("<[^>]*>", "", safe_mathml(piece)) == re.sub("<[^>]*>", "", piece).replace(
            "&InvisibleTimes;", "\N{INVISIBLE TIMES}"
        )


@pytest.mark.hostile("study folders")
@pytest.mark.parametrize(
    "piece",
    [
        "<mi href='javascript:alert(1)'>x</mi>",
        "<mi onclick=alert(1)>x</mi>",
        "<mi style='background:url(http://evil.example)'>x</mi>",
        "<maction actiontype='statusline#http://evil.example'><mi>x</mi></maction>",
        "<annotation-xml encoding='text/html'><img src=x onerror=alert(1)></annotation-xml>",
        "<mtext><script>alert(1)</script></mtext>",
        "<mtext></math><img src=x onerror=alert(1)></mtext>",
        "<mglyph src='http://evil.example/a.png'></mglyph>",
        "<semantics><mi>x</mi></semantics><style>@import 'http://evil.example'</style>",
        "<!--><img src=x onerror=alert(1)>-->",
        "<![CDATA[<img src=x onerror=alert(1)>]]>",
        "<mi>x</mi></mrow></math><form action='http://evil.example'>",
        "&lt;img src=x onerror=alert(1)&gt;",
        "<MI ONCLICK='alert(1)'><MO mathvariant='x\" onload=\"y'>x",
    ],
)
def test_mathml_holds_layout_alone(piece):
    found = Elements(safe_mathml(piece))
    assert set(found.tags) <= {"mi", "mo", "mtext"}
    assert found.attributes == []
    assert safe_mathml(piece).count("<m") == safe_mathml(piece).count("</m")


@pytest.mark.hostile("study folders")
@pytest.mark.parametrize("piece", [None, 5, ["<mi>"], "<mi>" * 60_000])
def test_mathml_that_is_none_shows_nothing(piece):
    assert safe_mathml(piece) == ""

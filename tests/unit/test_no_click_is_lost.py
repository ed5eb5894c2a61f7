"""Widgets that a person may be clicking stay where they are as the page is drawn anew."""

from unittest.mock import MagicMock

import pytest

from spiral.app import press
from spiral.app.missing import CandidateList
from spiral.app.press import Press
from spiral.app.session import LiveStudy
from spiral.app.study import StudyState, new_study
from spiral.app.tab_row import TabRow


@pytest.fixture
def page():
    """A page of nobody's browser."""
    nicegui = pytest.importorskip("nicegui")
    from nicegui.page import page

    with nicegui.Client(page("/nobody"), request=None) as client:
        yield client.content


def test_a_press_holds_until_its_release_and_not_for_ever(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(press.time, "monotonic", lambda: now[0])
    mouse = Press()
    assert not mouse.is_held()
    mouse.since = 0.0
    assert mouse.is_held()
    now[0] = 60.0  # its release was never told
    assert not mouse.is_held()


def test_tabs_stay_as_others_come_between_them(page):
    chosen = []
    tabs = TabRow("panel", chosen.append)
    tabs.show(["Measured", "Model"], "Measured")
    row = next(iter(page.default_slot.children))
    before = list(row.default_slot.children)
    tabs.show(["Measured", "Missing force", "Model"], "Measured")
    after = list(row.default_slot.children)
    assert [t.props["name"] for t in after] == ["Measured", "Missing force", "Model"]
    assert [after[0], after[2]] == before
    tabs.show(["Measured", "Model"], "Measured")
    assert list(row.default_slot.children) == before
    assert chosen == []  # what the program shows is no click


def test_candidates_that_are_shown_stay_as_the_others_join_them(page, tmp_path):
    rows = [
        {"effect": f"effect_{i}", "meaning": "A force: F = -k q.", "explains": 0.1, "net": 0.1,
         "p_value": 0.5, "wald_p_value": 0.5, "aliases": ()}
        for i in range(8)
    ]  # fmt: skip
    turn = StudyState(0, "", {}, candidates=tuple(rows), proposed=("effect_6",),
                      verdict="no_candidate")  # fmt: skip
    redrawn = []
    missing = CandidateList(MagicMock(), "", lambda what: what(), lambda: redrawn.append(1))
    missing._draw_candidates(LiveStudy(new_study(tmp_path, "x", ())), turn)
    place = next(e for e in page.descendants() if "candidates" in e.classes)
    before = list(place.default_slot.children)
    more = list(page.default_slot.children)[-1]
    for count in (8, 6):
        for listener in more._event_listeners.values():
            listener.handler(None)
        shown = list(place.default_slot.children)
        assert len(shown) == count
        assert set(before) <= set(shown)
    assert shown == before
    assert redrawn == []


def test_a_narrow_window_folds_all_but_three_as_figures_stand_below(monkeypatch, tmp_path):
    turn = StudyState(0, "", {}, candidates=tuple({"effect": f"e{i}"} for i in range(8)),
                      proposed=("e6",))  # fmt: skip
    scene = LiveStudy(new_study(tmp_path, "x", ()))
    listed = CandidateList(MagicMock(), "", lambda what: what(), lambda: None)
    for narrow, count in ((True, 3), (False, 5)):
        monkeypatch.setattr("spiral.app.missing.is_narrow", lambda narrow=narrow: narrow)
        shown = [c["effect"] for c in listed._listed(scene, turn)]
        assert shown == [*(f"e{i}" for i in range(count)), "e6"]

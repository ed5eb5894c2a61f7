"""The list of studies: found by words, named and noted, taken away whole, deleted."""

import io
import json
import zipfile
from dataclasses import replace

import pytest

from spiral.app.study import StudyState, new_study, save_study
from tests.browser.steps import faults


@pytest.fixture
def three(served):
    """Two studies with a step each, and one that failed, with names that no other test has."""
    turn = StudyState(0, "", {"test_error": 0.5}, (), run_id="20260101-000000-abc")
    step = StudyState(
        1, "gyroscopic", {"test_error": 0.02}, (), parent=0, run_id="20260101-000000-abd"
    )
    found = []
    for title, turns in (("zebra plain", (turn,)), ("zebra striped", (turn, step)), ("zebra", ())):
        made = new_study(served.out, title, ("experiment=rotor_coastdown",))
        wrong = None if turns else {"given": "a file that is gone"}
        found.append(replace(made, turns=turns, at=max(len(turns) - 1, 0), serials=2,
                             trouble=wrong))  # fmt: skip
        save_study(served.out, found[-1])
    return found


def titles(tab):
    return tab.eval_on_selector_all("#studies tr td:first-child a:visible",
                                    "all => all.map(a => a.innerText)")  # fmt: skip


def item(tab, title, said):
    tab.click(f"button[aria-label='Study {title}: name, export, delete']")
    tab.click(f".q-menu .q-item:has-text('{said}')")


def test_studies_are_found_named_and_noted(tab, served, three, picture):
    tab.goto(served.address)
    tab.fill("input[aria-label='Search studies']", "zebra GYRO")
    tab.wait_for_function("document.querySelectorAll('#studies tr td:first-child').length === 1")
    assert titles(tab) == ["zebra striped"]
    tab.fill("input[aria-label='Search studies']", "zebra")
    tab.wait_for_selector("#studies :text('1 without a fit')")  # which does not crowd the others
    assert titles(tab) == ["zebra striped", "zebra plain"]
    item(tab, "zebra plain", "Name and note")
    tab.fill(".dialog input[aria-label='Name']", "zebra at night")
    tab.fill(".dialog textarea", "Bearing 2 was <b>changed</b>.")
    # axe-core takes the dimmed page for what is behind these letters, which is a white card.
    assert {rule for rule, _ in faults(tab, ".dialog")} <= {"color-contrast"}
    picture(tab, "study-named")
    tab.click(".dialog button:has-text('Save')")
    tab.wait_for_selector("#studies a:has-text('zebra at night')")
    tab.fill("input[aria-label='Search studies']", "bearing")
    tab.wait_for_function("document.querySelectorAll('#studies tr td:first-child').length === 1")
    assert "Bearing 2 was <b>changed</b>." in tab.inner_text("#studies")
    assert faults(tab) == []
    picture(tab, "studies")
    tab.set_viewport_size({"width": 390, "height": 844})
    wide = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
    assert tab.evaluate(wide) <= 0
    tab.click("#studies a:has-text('zebra at night')")
    tab.wait_for_selector("#note:has-text('Bearing 2')")
    assert tab.inner_text("h1") == "zebra at night"


def test_a_study_is_taken_away_whole_and_deleted(tab, chromium, served, three):
    folder = served.out / "20260101-000000-abd"
    folder.mkdir(exist_ok=True)
    (folder / "run.json").write_text("{}")
    address = f"{served.address}/study/{three[1].ident}"
    tab.goto(address)
    tab.wait_for_selector(".chip, #branches, button:has-text('Undo')")
    with tab.expect_download() as taken:
        item(tab, "zebra striped", "Export the whole study")
    assert taken.value.suggested_filename == "zebra striped.zip"
    archive = zipfile.ZipFile(io.BytesIO(taken.value.path().read_bytes()))
    assert json.loads(archive.read("study.json"))["title"] == "zebra striped"
    assert "runs/20260101-000000-abd/run.json" in archive.namelist()
    assert "spiral add gyroscopic experiment=rotor_coastdown" in (
        archive.read("command.txt").decode().replace("\\\n    ", "")
    )
    other = served.enter(chromium.new_page())
    other.goto(address)
    other.wait_for_selector("button:has-text('Undo')")
    item(tab, "zebra striped", "Delete")
    tab.click(".dialog button:has-text('Delete it')")
    at_the_list = "() => location.pathname === '/'"
    tab.wait_for_function(at_the_list)
    other.wait_for_function(at_the_list)  # a tab that showed it goes to the list
    other.close()
    assert not (served.out / "studies" / three[1].ident).exists()
    assert folder.is_dir()

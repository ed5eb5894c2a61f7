"""Files and folders made to run a script, or to fetch something, in the browser that shows them."""

import json
import threading
from dataclasses import asdict
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from spiral.app import study as kept
from spiral.app.study import StudyState
from tests.browser.steps import upload

SCRIPT = "window.ran = (window.ran || 0) + 1"
PROP = f'm" :autofocus="{SCRIPT}" :label="{SCRIPT}'
FENCE = f"x\n```\n<img src=a onerror='{SCRIPT}'>\n```\n"


def html(foreign):
    """A text that would run a script and fetch a picture, were it taken for HTML."""
    return f'"><img src="{foreign}/a.png" onerror="{SCRIPT}"><script>{SCRIPT}</script>'


@pytest.fixture
def foreign():
    """A server elsewhere that must not be asked for anything."""
    asked = []

    class Counting(BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append(self.path)
            self.send_error(404)

        def log_message(self, *words):
            """Say nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Counting)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    assert asked == []


@pytest.fixture
def page(chromium, served):
    """A page whose console may tell of what its policy refused."""
    opened = served.enter(chromium.new_page())
    yield opened
    opened.close()


@pytest.fixture
def watched(page):
    """A page that has run no script of a file in the end, and made no picture of one."""
    yield page
    assert page.evaluate("window.ran") is None
    assert page.evaluate("document.querySelectorAll('img[onerror]').length") == 0


def test_a_unit_of_an_hdf5_attribute_stays_a_text(watched, served, foreign, tmp_path):
    """It became a prop of the box beside its column, and ran as JavaScript."""
    h5py = pytest.importorskip("h5py")
    file = tmp_path / "hostile.h5"
    rng = np.random.default_rng(0)
    with h5py.File(file, "w") as target:
        for name, unit in (
            ("time", "s"),
            (FENCE.replace("/", "_"), PROP),
            ("hammer", html(foreign)),
        ):
            data = np.arange(3000) / 500.0 if name == "time" else rng.normal(size=3000)
            target.create_dataset(name, data=data).attrs["units"] = unit
    upload(watched, served, file)
    watched.wait_for_selector(".mapping")
    watched.click("[data-for='x'] .q-select")
    watched.click(".q-menu .q-item >> nth=-1")
    watched.wait_for_function(
        "unit => [...document.querySelectorAll('input')].some(b => b.placeholder === unit)",
        arg=PROP,
    )  # shown as it is
    assert "<img" in watched.inner_text("main")


def test_a_folder_of_studies_shows_its_texts_and_runs_none(watched, served, foreign):
    evil = html(foreign)
    study = kept.new_study(served.out, f"hostile {evil}", (f"record.path={FENCE}", evil))
    found = {
        "effect": evil, "meaning": f"{evil}: a = {evil}", "aliases": [evil], "explains": 0.5,
        "p_value": 0.1, "wald_p_value": 0.1,
    }  # fmt: skip
    result = {"test_error": 0.5, "fit_error": 0.5, "chi2_per_dof": 1.0, "whiteness_p": 0.5,
              "horizon": 64, "channels": {evil: {"rmse": 1.0, "relative": 0.1}},
              "model": {"effects": {evil: {}}, "system": {}}}  # fmt: skip
    turn = StudyState(
        0, evil, result, (found,), (evil,), {evil: evil}, evil, evil, evil, {}, evil,
        ({"left": evil, "terms": [{"owner": evil, "math": evil}]},),
        (("free_run", evil, evil),), True, "20200101-000000-abc", "", evil,
    )  # fmt: skip
    data = {**asdict(kept.add_turn(study, turn)), "plugins": "/nowhere"}
    data["trouble"] = {"given": evil, "expected": evil, "try": evil}
    folder = kept.study_folder(served.out, study.ident)
    picture = [{"source": f"{foreign}/b.png", "x": 0, "y": 0, "sizex": 1, "sizey": 1}]
    figure = {"data": [{"type": "scatter", "x": [0, 1], "y": [0, 1], "name": evil}],
              "layout": {"height": 300, "title": {"text": evil}, "images": picture}}  # fmt: skip
    (folder / "turn-0" / "figures").mkdir(parents=True)
    (folder / "turn-0" / "figures" / "free_run.json").write_text(json.dumps(figure))
    (folder / kept.FILE).write_text(json.dumps(data))
    watched.goto(served.address)
    watched.wait_for_selector("td a:has-text('hostile')")
    watched.click("td a:has-text('hostile')")
    watched.wait_for_selector("#error-now")
    watched.wait_for_selector("#plot-free_run .main-svg")
    watched.click("text=The data, and this as a command and in Python")
    watched.wait_for_selector(".command code:visible")
    assert "```" in watched.inner_text(".command code")
    watched.click(".q-tab:has-text('Model') >> nth=-1")
    watched.wait_for_selector(".equation")
    watched.wait_for_timeout(500)
    (folder / kept.FILE).unlink()


def test_a_script_in_an_attribute_does_not_run_even_if_it_came_into_the_page(page, served):
    """The policy holds by itself: also where a text should slip through, now or later."""
    page.goto(served.address)
    page.wait_for_selector("#drop")
    blocked = page.evaluate(
        """async () => {
          const seen = new Set();
          document.addEventListener("securitypolicyviolation",
            (e) => seen.add(e.effectiveDirective));
          const box = document.createElement("div");
          box.innerHTML = '<img src="x" onerror="window.ran = 1">'
            + '<img src="http://127.0.0.1:9/a.png">';
          document.body.append(box);
          await fetch("http://127.0.0.1:9/").catch(() => {});
          for (let i = 0; i < 200 && seen.size < 3; i++)
            await new Promise((done) => setTimeout(done, 100));
          box.remove();
          return [window.ran || 0, ...seen].sort();
        }"""
    )
    assert blocked == [0, "connect-src", "img-src", "script-src-attr"]

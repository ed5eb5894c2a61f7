"""The report of a saved run: one file, every figure, no network, from what was saved alone."""

import json
import re
import shlex
from html.parser import HTMLParser
from itertools import combinations

import numpy as np
import pytest

import spiral
from spiral.cli import main
from spiral.io.curves import FILE, FINAL, Curves, read_curves
from spiral.io.storage import load_run, read_run
from spiral.view.report.evidence import error_falling
from spiral.view.report.motion import orbit
from spiral.view.report.pictures import find_browser, write_png
from spiral.view.report.style import scale_to_prefix, thin_curve
from spiral.view.report.text import report_header
from spiral.view.terminal.shell import quote_word as shell_word

STUDY = ("discover", "experiment=rotor_coastdown", "record.duration=2.5", "settings.max_rounds=2",
         "candidates=[cross_stiffness,cubic_stiffness,gyroscopic,rub]",
         "tracking.enabled=false")  # fmt: skip
FIGURES = {
    "before", "where", "amplitude", "missing_force", "surface", "error_falling", "evidence",
    "coefficients", "free_run", "orbit", "bode", "polar", "waterfall", "whirl", "correlation",
    "hidden", "campbell",
}  # fmt: skip


@pytest.fixture(autouse=True)
def without_curves():
    """These tests are about curves: nothing is put in their place."""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """One real study and its report."""
    folder = tmp_path_factory.mktemp("reported")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert main(list(STUDY)) == 0
        assert main(["report", "run=latest", "--out", "a.html", "--json", "report.json"]) == 0
    return folder


@pytest.fixture(scope="module")
def saved(place):
    return load_run("latest", place / "runs")


@pytest.fixture(scope="module")
def html(place):
    return (place / "a.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def curves(saved):
    return read_curves(saved.file.parent)


def test_a_port_between_two_masses_has_its_missing_force_drawn():
    """What such a port measures, b - a, is no state to draw the force over."""
    between = spiral.system(
        ["m*a'' + c*a' + k*a + joint*(a - b) = F", "m*b'' + c*b' + k*b + joint*(b - a) = 0"],
        states={"a": "m", "b": "m"}, inputs={"F": "N"}, observed=["a"], ports={"gap": "b - a"},
        parameters={"m": (1.0, "kg"), "c": (1.0, "N*s/m"), "k": (90.0, "N/m"),
                    "joint": (50.0, "N/m")},
    )  # fmt: skip
    force = {"F": {"noise": 1.0, "band": [0.5, 5]}}
    record = spiral.simulate(between, 6.0, 50.0, inputs=force, noise_level=0.01)
    run = spiral.discover(record, between, candidates=[])
    drawn = spiral.plot.figures(run)["surface"]
    over = [axis.title.text.partition(" ")[0] for axis in drawn.select_xaxes()]
    assert over == ["a", "b", "a'", "b'"]


class Fetches(HTMLParser):
    """Addresses that a browser would fetch, and ids."""

    def __init__(self):
        super().__init__()
        self.addresses, self.ids = [], set()

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.addresses += [v for k, v in attrs if k in ("src", "href", "data") and v]
        self.ids.add(found.get("id"))


def test_every_figure_is_there_and_nothing_is_fetched(html, place):
    seen = Fetches()
    seen.feed(html)
    assert seen.addresses == []
    assert "@import" not in html.split("<script>")[0]
    assert seen.ids >= FIGURES
    assert set(json.loads((place / "report.json").read_text())["figures"]) == FIGURES
    assert html.count("plotly.js v") == 1


def test_the_story_says_what_was_found_and_how_to_do_it_again(html, saved):
    text = re.sub(r"<script.*?</script>", "", html, flags=re.S)
    result = saved.result
    for effect in (e for r in result["rounds"] for e in r["admitted"]):
        assert effect in text
    assert "record.duration=2.5" in text
    assert all(r["sha256"] in text for group in saved.data["data"].values() for r in group)
    assert "is short (2500 samples)" in text
    assert "<math" in text
    assert "The model fails between" in text


def test_curves_agree_with_the_run_they_belong_to(curves, saved):
    """The free run that is drawn has the test error that was reported."""
    test = [r["part"] for r in curves.meta["records"]].index("test")
    y, first = curves.get(test, "y"), curves.meta["records"][test]["settled"]
    for model, found in (
        ("seed", saved.result["rounds"][0]),
        ("final", saved.result["rounds"][-1]),
    ):
        left = (y - curves.get(test, model, "free"))[first:]
        relative = np.sqrt(np.mean(left**2, axis=0)) / y[first:].std(axis=0)
        assert np.mean(relative) == pytest.approx(found["test_error"], rel=1e-3)


def test_the_missing_force_shrinks_when_the_effects_are_added(curves):
    before, after = (curves.get(0, m, "force") for m in ("seed", "final"))
    assert after.std() < 0.2 * before.std()


def test_a_round_that_runs_away_is_marked_and_drawn_beside_the_others():
    rounds = [{"round": 0, "admitted": [], "fit_error": 0.4, "test_error": 1.1},
              {"round": 1, "admitted": ["cubic_stiffness"], "fit_error": None,
               "test_error": None}]  # fmt: skip
    figure = error_falling({"rounds": rounds})
    assert [a.text for a in figure.layout.annotations] == [
        "<b>110 %</b><br>as it was", "<b>↑ not finite</b><br>+ cubic stiffness"
    ]  # fmt: skip
    assert error_falling({"rounds": rounds[1:]}, least=1) is None


@pytest.mark.parametrize("width", [700, 250])
@pytest.mark.parametrize("errors", [(0.7, 0.0095, 0.0094, 0.0093, 0.0093),
                                    (1.08, 0.566, 0.0686, 0.028, 0.0191)])  # fmt: skip
def test_labels_of_the_curve_of_errors_neither_overlap_nor_leave_it(errors, width):
    rounds = [{"round": i, "admitted": ["cross_damping"] * (i > 0), "fit_error": e, "test_error": e}
              for i, e in enumerate(errors)]  # fmt: skip
    figure = error_falling({"rounds": rounds, "noise_floor": 0.009}, width=width, height=500)
    first, last = figure.layout.xaxis.range
    low, high = figure.layout.yaxis.range
    labels = [a for a in figure.layout.annotations if "noise floor" not in a.text]
    across, up = width / (last - first), 400 / (high - low)
    corners = [((a.x - first) * across + 7, (a.y - low) * up + a.yshift) for a in labels]
    assert len(corners) == len(errors)
    assert all(x + 105 <= width and 0 <= y <= 400 for x, y in corners)
    for (x, y), (other_x, other_y) in combinations(corners, 2):
        assert abs(x - other_x) >= 105 or abs(y - other_y) >= 34  # 15 letters, two lines


@pytest.mark.parametrize(
    "word", ["record.time=t", "record.path='a b.csv'", "a=$HOME's", 'say="it\'s"', "a b", "x='\\'"]
)
def test_a_word_for_a_shell_is_read_back_as_it_was(word):
    assert shlex.split(shell_word(word)) == [word]


def test_it_needs_nothing_but_the_saved_run(place, tmp_path, monkeypatch, saved):
    """Neither the record nor the plugins: the folder of one run, anywhere."""
    import shutil

    from spiral.view.report.html import report_page

    shutil.copytree(saved.file.parent, tmp_path / "elsewhere")
    monkeypatch.chdir(tmp_path)
    other = read_run(tmp_path / "elsewhere" / "run.json")
    names = report_page(other.data, read_curves(tmp_path / "elsewhere"))[1]
    assert set(names) == FIGURES
    (tmp_path / "elsewhere" / FILE).unlink()
    html, names = report_page(other.data, read_curves(tmp_path / "elsewhere"))
    assert set(names) == {"error_falling", "evidence", "coefficients"}
    assert "kept no curves" in html


@pytest.mark.parametrize(
    ("words", "said"),
    [(["run=nosuch"], "run=nosuch"), (["speed=3"], "report speed"), (["x"], "report x"),
     (["--out", "no/such/folder/a.html"], "a file that can be written")],
)  # fmt: skip
def test_bad_input_is_told_in_one_message(place, monkeypatch, capsys, words, said):
    monkeypatch.chdir(place)
    assert main(["report", *words]) == 2
    assert said in capsys.readouterr().err


def test_thinning_keeps_every_peak_of_a_million_samples():
    rng = np.random.default_rng(0)
    x, y = np.arange(1_000_000) * 1e-3, rng.normal(size=1_000_000)
    y[[0, 123_456, 777_777]] = 0.0, 40.0, -50.0
    thin_x, thin_y = thin_curve(x, y, 3000)
    assert len(thin_x) <= 3002
    assert np.all(np.diff(thin_x) > 0)
    assert (thin_y.max(), thin_y.min()) == (40.0, -50.0)
    assert thin_x[np.argmax(thin_y)] == x[123_456]


@pytest.mark.parametrize(
    ("unit", "largest", "expected"),
    [("m", 5e-5, (1e6, "µm")), ("m/s^2", 0.3, (1e3, "mm/s²")), ("V", 2.0, (1.0, "V")),
     ("1/s^2", 8e3, (1.0, "1/s²")), ("1", 3.0, (1.0, ""))],
)  # fmt: skip
def test_units_are_scaled_to_be_read(unit, largest, expected):
    factor, text = scale_to_prefix(unit, np.array([-largest, 0.0, np.nan]))
    assert (factor, text) == (pytest.approx(expected[0]), expected[1])


@pytest.mark.slow
@pytest.mark.skipif(find_browser() is None, reason="no browser that runs without a window")
def test_a_browser_draws_it(html, tmp_path):
    file = write_png(html, tmp_path / "report.png", 1000, 2400)
    assert file.stat().st_size > 50_000


@pytest.mark.parametrize(("carried", "drawn"), [(True, [5.0, 4.0]), (False, [95.0, 103.0])])
def test_errors_one_sample_ahead_fall_where_a_free_run_is_no_test(carried, drawn):
    rounds = [
        {"round": k, "admitted": ["drag"][:k], "fit_error": 0.9, "test_error": free,
         "unseen": [{"samples": 1, "error": ahead}, {"samples": None, "error": free}],
         "details": {"carried_away": True} if carried else {}}
        for k, (free, ahead) in enumerate([(0.95, 0.05), (1.03, 0.04)])
    ]  # fmt: skip
    figure = error_falling({"rounds": rounds, "noise_floor": 0.01})
    traces = {t.name: t for t in figure.data}
    assert list(traces["test error"].y) == pytest.approx(drawn)
    assert ("fit error" in traces) != carried
    assert ("one sample ahead" in figure.layout.yaxis.title.text) == carried


def test_the_title_names_look_alikes_too():
    rounds = [{"admitted": ["cubic_loss@T"], "aliases": {"cubic_loss@T": ["radiation_loss@T"]}}]
    saved = {"verb": "discover", "created": "2026-11-27T10:00", "config": {"system": {"name": "s"}},
             "result": {"missing": ["cubic_loss@T"], "rounds": rounds, "summary": "s"}}  # fmt: skip
    head = report_header(saved, None)
    assert "<h1>Missing: cubic loss at T (or radiation loss at T)</h1>" in head


def test_an_orbit_is_of_two_readings_of_one_unit():
    path = np.column_stack([np.sin(np.arange(300) / 9), np.cos(np.arange(300) / 9)])
    arrays = {"0.y": path, f"0.{FINAL}.free": path}
    for unit, drawn in (("m", True), ("Pa", False)):
        channels = [{"name": "x", "unit": "m"}, {"name": "p", "unit": unit}]
        assert (orbit(Curves({"channels": channels}, arrays), 0) is not None) == drawn

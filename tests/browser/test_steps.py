"""What a step does to data that it did not see: said, not proposed where it is worse, undone."""

import re
from dataclasses import replace

import numpy as np
import pytest

from spiral.app.study import StudyState, new_study, save_study, turn_folder
from spiral.view.report.style import add_hover_text
from spiral.view.report.unknown import force_loops
from tests.browser.steps import SECOND, add, error, filled, judged, legend, ready, shows

RATE, SAMPLES = 500.0, 3000


def softening(time):
    """A spring that gives way, driven twice as hard in the part that becomes the test record.

    A cubic spring fitted to the first part passes every gate there, and pushes outwards beyond it.
    """
    from scipy.integrate import solve_ivp

    rng = np.random.default_rng(2)
    tones = [(f, rng.uniform(0, 6.3)) for f in np.arange(1.0, 12.0, 0.6)]

    def force(t):
        return 6 * (1 + (np.asarray(t) > 4.7)) * sum(np.sin(6.283 * f * t + p) for f, p in tones)

    def rate(t, s):
        return [s[1], force(t) - 6 * s[1] - 1000 * s[0] - 60 * np.tanh(s[0] / 0.02)]

    x = solve_ivp(rate, (0, time[-1]), [0, 0], t_eval=time, rtol=1e-8, atol=1e-10, max_step=0.01)
    noisy = x.y[0] + rng.normal(size=len(time)) * 0.01 * x.y[0].std()
    return np.column_stack([time, noisy, force(time)])


@pytest.fixture(scope="module")
def study(served, chromium, tmp_path_factory):
    """The address of a study whose first proposal makes predictions worse.

    With ``shooting``: the likelihood of the whole record does not admit it in the first place. The
    true effect (``preload``) is no candidate.
    """
    file = tmp_path_factory.mktemp("steps") / "softening.csv"
    rows = softening(np.arange(SAMPLES) / RATE)
    np.savetxt(file, rows, "%.9g", delimiter=",", header="t,x,force", comments="")
    known = "candidates=[cubic_stiffness,quadratic_stiffness,clearance,coulomb_friction]"
    words = ("system=oscillator", "record=csv", f"record.path={file}", "strategy=shooting", known)
    made = new_study(served.out, "softening", words)
    page = served.enter(chromium.new_page())
    page.goto(f"{served.address}/study/{made.ident}")
    page.click("button:has-text('Fit the model as it is')")
    ready(page, SECOND)
    address = page.url
    page.close()
    return address


def test_an_effect_that_predicts_worse_is_not_the_filled_button(tab, study, picture):
    tab.goto(study)
    tab.wait_for_selector("#proposal.worse")
    said = tab.inner_text("#proposal")
    assert "cubic stiffness is confirmed" in said
    assert "predicts the test record worse: " in said
    assert "next sample, 0.1 s ahead and free run" in said
    assert filled(tab) == []
    assert "worse" in judged(tab, ".effect.first .tried")
    picture(tab, "step-worse-proposed")


def test_a_step_that_turned_out_worse_says_so_and_is_undone_with_one_click(tab, study, picture):
    tab.goto(study)
    ready(tab, SECOND)
    before = error(tab)
    fitted = tab.inner_text("#horizons")
    add(tab, SECOND)
    tab.wait_for_selector("#worse:has-text('Worse on data it did not see')")
    assert "cubic stiffness" in tab.inner_text("#worse")
    words = judged(tab, "#horizons")
    assert len(words) == 3
    assert "worse" in words
    arrows = tab.eval_on_selector_all("#horizons .judged", "all => all.map(e => e.innerText[0])")
    assert dict(zip(words, arrows, strict=True))["worse"] == "↑"  # not by colour alone
    tab.wait_for_selector("#worse button:has-text('Undo this step'):enabled")
    picture(tab, "step-worse-added")
    tab.click("#worse button:has-text('Undo this step')")
    tab.wait_for_selector("#worse", state="detached")
    shows(tab, before)
    assert tab.inner_text("#horizons") == fitted


def test_every_branch_is_kept_and_caveats_stand_beside_the_verdict(tab, served, picture):
    """A study on disk: two effects added to one turn, the second of them looked at."""
    doubts = ("Cubic stiffness cannot be told from clearance on this record.",)
    weak = {"effect": "stop", "meaning": "A stop.", "aliases": [], "explains": 0.001,
            "p_value": 0.5, "wald_p_value": 0.5}  # fmt: skip
    ranked = {"candidates": (weak,), "verdict": "whiteness", "run_id": "20260101-000000-abc"}

    def turn(serial, parent, added, error, **more):
        return StudyState(serial, added, {"test_error": error}, parent=parent, **ranked, **more)

    made = new_study(served.out, "branches", ("experiment=rotor_coastdown",))
    turns = (turn(0, None, "", 0.5), turn(1, 0, "clearance", 0.2), turn(2, 1, "rub", 0.15),
             turn(3, 0, "cubic_stiffness", 2e-7, caveats=doubts))  # fmt: skip
    save_study(served.out, replace(made, turns=turns, at=3, serials=4, noise_floor=1e-7))
    tab.goto(f"{served.address}/study/{made.ident}")
    tab.wait_for_selector("#branches")
    assert re.findall(r"[\w ]+: [<\d. ]+%", tab.inner_text("#branches")) == [
        "the model as it was: 50.0 %", " clearance: 20.0 %", " rub: 15.0 %",
        " cubic stiffness: < 0.001 %",
    ]  # fmt: skip
    assert tab.inner_text("#error-now").startswith("< 0.001 %")
    assert "Noise alone makes < 0.001 %" in tab.inner_text("main")
    tab.wait_for_selector("#plot-error-falling .main-svg")
    assert "noise floor < 0.001 %" in tab.text_content("#plot-error-falling")
    assert tab.inner_text("#caveats li") == doubts[0]
    assert "Nothing more is missing" in tab.inner_text("#ending")
    assert tab.locator(".order").count() == 0  # no candidate is shown
    assert tab.locator("button:has-text('Show 1 candidate')").count() == 1
    picture(tab, "branches")
    tab.click("#branches button:has-text('rub')")
    tab.wait_for_selector(".chip.added:has-text('rub')")
    assert error(tab) == [15.0, 50.0]
    tab.click("button:has-text('Undo'):enabled")
    tab.wait_for_selector("button:has-text('Redo rub')")
    tab.click("button:has-text('Undo'):enabled")
    tab.wait_for_selector("button:has-text('Redo clearance')")
    tab.click("button:has-text('Redo cubic stiffness')")
    tab.wait_for_selector("#caveats")


def test_memory_of_what_is_missing_is_told_and_drawn(tab, served, picture):
    """A study on disk: a loop that is there at every speed, with the sentence that tells it."""
    angle = np.linspace(0.0, 4 * np.pi, 160)
    loop = {"axis": "x", "position": (1e-3 * np.sin(angle)).tolist(),
            "force": (20 * np.cos(angle)).tolist()}  # fmt: skip
    told = "What is missing has memory: at mass 14 N (rms) depend on how the motion came there."
    figure = add_hover_text(
        force_loops({"memory": {"loops": [loop], "position_unit": "m", "unit": "N"}})
    )
    made = new_study(served.out, "memory", ("experiment=rotor_coastdown",))
    folder = turn_folder(served.out, made.ident, 0) / "figures"
    folder.mkdir(parents=True)
    (folder / "memory.json").write_text(figure.to_json())
    drawn = (("memory", "A force with memory", "There and back."),)
    turn = StudyState(
        0, "", {"test_error": 0.2}, (), verdict="no_candidate", memory=told, figures=drawn,
        run_id="20260101-000000-abc",
    )  # fmt: skip
    save_study(served.out, replace(made, turns=(turn,), serials=1))
    tab.goto(f"{served.address}/study/{made.ident}")
    tab.wait_for_selector("#ending:has-text('What is missing has memory')")
    tab.click(".q-tab:has-text('Missing force')")
    tab.wait_for_selector("#plot-memory .main-svg")
    assert legend(tab, "memory") == ["position grows", "position falls", "begins here"]
    picture(tab, "memory")


def test_an_effect_that_was_let_go_is_no_part_of_the_model(tab, served, picture):
    """A study on disk whose second step made the first superfluous: chips, curve, command."""

    def turn(serial, added, error, retired=()):
        names = [added] if added else []
        model = {"effects": {name: {} for name in ("linear_stiffness", *names)}, "system": {}}
        errors = {"test_error": error, "fit_error": error}
        more = {"admitted": names, "retired": list(retired), "model": model}
        return StudyState(serial, added, {**errors, **more})

    made = new_study(served.out, "let go", ("experiment=rotor_coastdown",))
    turns = (turn(0, "", 0.5), turn(1, "cross_damping", 0.2),
             turn(2, "probe_turn", 0.1, ["cross_damping"]))  # fmt: skip
    save_study(served.out, replace(made, turns=turns, at=2, serials=3))
    tab.goto(f"{served.address}/study/{made.ident}")
    tab.wait_for_selector(".chip")
    chips = tab.eval_on_selector_all(".chip", "all => all.map(c => c.innerText)")
    assert chips == ["linear stiffness", "+ probe turn"]
    assert "Removed: cross damping" in tab.inner_text(".gone")
    tab.wait_for_selector("#plot-error-falling .main-svg")
    curve = tab.text_content("#plot-error-falling")
    assert "+ probe turn" in curve
    assert "\N{MINUS SIGN} cross damping" in curve
    tab.click("text=as a command and in Python")
    tab.wait_for_selector("text=spiral add probe_turn ")
    picture(tab, "step-let-go")
    tab.goto(served.address)
    row = tab.inner_text("tr:has-text('let go')")
    assert "probe turn" in row
    assert "cross damping" not in row
    tab.goto(f"{served.address}/study/{made.ident}")
    tab.click("button:has-text('Undo'):enabled")
    tab.wait_for_selector(".chip.added:has-text('cross damping')")

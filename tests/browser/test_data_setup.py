"""The data desk: stretches marked on the picture, further files, sensors, a word before a fit."""

import numpy as np
import pytest

from experiments.journeys.screen import drag
from experiments.journeys.served import PATIENCE
from tests.browser.steps import choose, faults, held, legend, upload

RATE, SAMPLES = 500.0, 3000
BEGIN = "button:has-text('Compare with the model'):enabled"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Runs of a hardening spring, a machine that feeds itself, a free swing, a steady rotor."""
    from scipy.integrate import solve_ivp

    from tests.scenes import planar_record

    folder = tmp_path_factory.mktemp("desk")
    time = np.arange(SAMPLES) / RATE
    for seed in (1, 2, 3):
        rng = np.random.default_rng(seed)
        tones = [(f, rng.uniform(0, 6.3)) for f in np.arange(2.0, 20.0, 0.7)]

        def force(t, tones=tones):
            return 12 * sum(np.sin(6.283 * f * t + p) for f, p in tones)

        def rate(t, s, force=force):
            return [s[1], force(t) - 6 * s[1] - 4000 * s[0] - 2e6 * s[0] ** 3]

        x = solve_ivp(rate, (0, time[-1]), [0, 0], t_eval=time, rtol=1e-8, atol=1e-10).y[0]
        x += rng.normal(size=SAMPLES) * 0.01 * x.std()
        np.savetxt(folder / f"run{seed}.csv", np.column_stack([time, x, force(time)]), "%.9g",
                   delimiter=",", header="t,x,force", comments="")  # fmt: skip
    fed = solve_ivp(
        lambda t, s: [s[1], force(t) / 2 + 4 * s[1] - 2e4 * s[0] ** 2 * s[1] - 4000 * s[0]],
        (0, time[-1]), [0, 0], t_eval=time, rtol=1e-8, atol=1e-10,
    ).y[0]  # fmt: skip
    fed += rng.normal(size=SAMPLES) * 0.01 * fed.std()
    np.savetxt(folder / "fed.csv", np.column_stack([time, fed, force(time) / 2]), "%.9g",
               delimiter=",", header="t,x,force", comments="")  # fmt: skip
    swing = solve_ivp(
        lambda t, s: [s[1], -0.05 * s[1] - 20 * np.sin(s[0])], (0, 20), [0.5, 0],
        t_eval=np.arange(2000) / 100.0, rtol=1e-8,
    ).y[0]  # fmt: skip
    swing += np.random.default_rng(4).normal(size=2000) * 0.002
    np.savetxt(folder / "swing.csv", np.column_stack([np.arange(2000) / 100.0, swing]), "%.9g",
               delimiter=",", header="t,angle", comments="")  # fmt: skip
    steady = planar_record(3, noise=0.01, duration=10.0, hertz=(20.0, 20.0))
    rows = np.column_stack([steady.time, steady.channels["x"], steady.channels["y"],
                            steady.inputs["speed"]])[8000:]  # fmt: skip
    np.savetxt(folder / "steady.csv", rows, "%.9g", delimiter=",", header="t,x,y,speed",
               comments="")  # fmt: skip
    return folder


def begun(tab, served, file, system):
    """Drop a file whose columns are named as the system's series."""
    upload(tab, served, file, system)
    tab.wait_for_selector(BEGIN)


def rows(tab):
    """Fitted from, to, test from, to, as the fields show them."""
    names = [f"{use} rows {end}" for use in ("Fitted", "Test") for end in ("from", "to")]
    return [tab.input_value(f"input[aria-label='{name}']") for name in names]


def mark(tab, what, use):
    """Choose what a drag marks; the picture follows once the program has answered."""
    tab.click(f"button:has-text('{what}')")
    tab.wait_for_function("(use) => document.getElementById('plot-columns')"
                          "?._fullLayout?.meta === use", arg=use)  # fmt: skip


@pytest.mark.slow
def test_stretches_are_marked_with_the_mouse_or_typed(tab, served, files, picture):
    begun(tab, served, files / "run1.csv", "oscillator")
    assert "The last part is kept apart" in tab.inner_text("#apart")
    assert "x in m, force in N, time in s" in tab.inner_text("#units-taken")  # a header of names
    mark(tab, "Mark the test", "test")
    drag(tab, 0.1, 0.4)
    tab.wait_for_selector("#apart:has-text('No fit sees the test record: run1.csv rows [')")
    fit_from, fit_to, test_from, test_to = map(int, rows(tab))
    assert [test_from, test_to] == pytest.approx([300, 1200], abs=15)
    assert (fit_from, fit_to) == (test_to, SAMPLES)  # the longer side, and no row twice
    assert tab.locator("#plot-columns .shapelayer path").count() == 2
    mark(tab, "Mark what is fitted", "fit")
    drag(tab, 0.3, 0.9)
    tab.wait_for_function("(was) => document.querySelector(\"input[aria-label='Test rows to']\")"
                          ".value !== was", arg=str(test_to))  # fmt: skip
    fit_from, fit_to, _, test_to = map(int, rows(tab))
    assert test_to == fit_from == pytest.approx(900, abs=15)
    tab.fill("input[aria-label='Fitted rows from']", "2000")
    tab.click("input[aria-label='Fitted rows to']")  # leaving a field takes its number over
    tab.keyboard.press("Control+A")
    tab.keyboard.type("260")
    tab.wait_for_selector(f"main:has-text('fit: {fit_to - 2000} samples at 500 Hz')")
    tab.keyboard.type("0")
    tab.keyboard.press("Enter")  # what was being typed has not been overwritten
    tab.wait_for_selector("main:has-text('fit: 600 samples at 500 Hz')")
    picture(tab, "desk-stretches")
    assert faults(tab) == []
    tab.click("button:has-text('All rows')")
    tab.wait_for_selector("#apart:has-text('The last part is kept apart')")
    assert rows(tab) == ["", "", "", ""]


def test_a_second_file_is_the_test_and_a_third_is_fitted_too(tab, served, files, picture):
    begun(tab, served, files / "run1.csv", "oscillator")
    for number, said in ((2, "fit: 3000 samples"), (3, "fit: 6000 samples")):
        tab.set_input_files("#drop-file", files / f"run{number}.csv")
        tab.wait_for_selector(f"#files:has-text('run{number}.csv')")
        tab.wait_for_selector(f"main:has-text('{said} at 500 Hz')")
        assert tab.inner_text("#apart").startswith("No fit sees the test record: run2.csv.")
    tab.click("text=Sensors and inputs")
    tab.click(".instruments .q-select")
    tab.click(".q-menu .q-item:has-text('band-limited')")
    tab.wait_for_selector(BEGIN)
    picture(tab, "desk-files")
    tab.emulate_media(color_scheme="dark")
    assert faults(tab) == []
    tab.reload()  # nothing of it is lost
    tab.wait_for_selector("#files:has-text('run3.csv')")
    tab.click("#files .q-select >> nth=1")
    tab.click(".q-menu .q-item:has-text('leave it out')")
    tab.wait_for_selector("main:has-text('fit: 3000 samples at 500 Hz')")
    assert "run3.csv" not in tab.inner_text("#files")
    tab.click(BEGIN)
    tab.wait_for_selector("h1:has-text('run1.csv and 1 more')")
    tab.click("text=as a command and in Python")
    told = tab.inner_text(".command >> nth=0")
    assert "run2.csv'" in told.partition("test.path=")[2].partition("\n")[0]
    assert "record.hold={force: band_limited}" in told
    tab.click("button:has-text('Cancel')")


@pytest.mark.slow
def test_what_a_record_cannot_tell_is_said_before_any_fit(tab, served, files, picture):
    begun(tab, served, files / "steady.csv", "planar rotor")
    tab.wait_for_selector("#foresight:has-text('cannot tell apart')", timeout=PATIENCE)
    said = tab.inner_text("#foresight")
    assert "linear stiffness (in the model)" in said
    assert "take a run-up or run-down instead" in said
    tab.click("text=Plan the test that tells them apart")
    assert tab.inner_text(".command >> nth=0").startswith("spiral plan ")
    picture(tab, "desk-foresight")
    tab.click("text=Sensors and inputs")
    for end, speed in (("from", "1"), ("to", "5")):
        tab.fill(f'input[aria-label="slow roll {end} speed, in the file\'s unit"]', speed)
    tab.wait_for_selector("[role=alert] .places:has-text('record.slow_roll under Sensors')")
    assert "no sample between 1 and 5 rad/s" in tab.inner_text("[role=alert]")
    assert faults(tab) == []


@pytest.mark.slow
def test_equations_typed_into_a_box_are_the_system(tab, served, files, picture):
    """A mistake is told beside the box; what is right is fitted, and what it lacks is ranked."""
    rows = (files / "run1.csv").read_text().replace("t,x,force", "t,x,F", 1).splitlines()
    (files / "own.csv").write_text("\n".join(rows[: SAMPLES // 2]))
    tab.goto(served.address)
    tab.set_input_files("#drop-file", files / "own.csv")
    tab.click("text=Write equations of your own")
    box = "textarea[aria-label='Equations of the system']"
    example = tab.input_value(box)
    assert "observed: [x]" in example
    spring = """title: A mass on a spring
equations:
  - m*x'' + c*x' + k*x = F
states: {x: m}
inputs: {F: N}
parameters: {m: 1.0 kg, c: N*s/m, k: N/m}
observed: [x]
"""
    tab.fill(box, spring.replace("k: N/m", "k: N/m^2"))
    tab.click("button:has-text('Use these equations')")
    tab.wait_for_selector(".equations .trouble")
    assert tab.inner_text(".equations .trouble").startswith("equation 1, ")
    below = tab.locator(".equations .trouble").bounding_box()["y"]
    assert below - tab.locator(box).bounding_box()["y"] < 400  # beside the box
    picture(tab, "equations-wrong")
    tab.fill(box, spring)
    tab.click("button:has-text('Use these equations')")
    tab.wait_for_selector("main:has-text('A mass on a spring')")
    tab.wait_for_selector(BEGIN)
    assert tab.locator(".equations .trouble").count() == 0
    tab.wait_for_selector("#foresight:has-text('can tell all')")  # k is no rival of itself
    picture(tab, "equations")
    assert faults(tab) == []
    tab.click(BEGIN)
    tab.wait_for_selector("button[aria-label='Add cubic stiffness']:enabled")
    tab.click("text=as a command and in Python")
    assert "system='" in tab.inner_text(".command >> nth=0")
    picture(tab, "equations-study")


@pytest.mark.slow
def test_the_model_is_drawn_before_it_is_fitted_and_as_it_has_become(tab, served, files, picture):
    begun(tab, served, files / "run1.csv", "oscillator")
    tab.wait_for_selector("svg.sketch")
    assert "linear damping" in tab.text_content("svg.sketch")
    tab.click(".seed .q-toggle >> nth=1")  # a machine without a damper
    tab.wait_for_function(
        "() => !document.querySelector('svg.sketch').textContent.includes('linear damping')"
    )
    tab.click("text=The sketch in words")
    tab.wait_for_selector("li:has-text('The input force acts on x.')")
    assert faults(tab) == []
    picture(tab, "sketch-of-the-model")
    tab.emulate_media(color_scheme="dark")
    assert faults(tab) == []
    picture(tab, "sketch-of-the-model-dark")
    tab.set_viewport_size({"width": 390, "height": 900})
    tab.wait_for_function("document.documentElement.scrollWidth <= innerWidth")
    assert faults(tab, ".sketched") == []


@pytest.mark.slow
def test_a_sign_that_a_passive_machine_does_not_have_is_told_beside_the_value(
    tab, served, files, picture
):
    """x'' - 4 x' + 2e4 x^2 x' + 4000 x = force, as in a squealing brake."""
    begun(tab, served, files / "fed.csv", "oscillator")
    tab.click(BEGIN)
    tab.click("button[aria-label='Add amplitude damping']:enabled")
    tab.wait_for_selector("#caveats:has-text('Linear damping, damping: negative damping')")
    tab.click(".q-tab >> nth=-1")
    tab.wait_for_selector("td:has-text('feeds energy in, which a passive machine does not')")
    assert faults(tab) == []
    picture(tab, "signs")


def test_what_reading_changes_is_drawn_before_it_is_fitted(tab, served, files, picture, tmp_path):
    lines = (files / "run1.csv").read_text().splitlines()
    for row in (801, 802):  # two readings that the logger lost
        time, _, force = lines[row].split(",")
        lines[row] = f"{time},,{force}"
    (tmp_path / "gap.csv").write_text("\n".join(lines) + "\n")
    upload(tab, served, tmp_path / "gap.csv")
    tab.click("#advice button:has-text('record.fill_gaps=2')")
    tab.wait_for_selector("#plot-reading .main-svg")
    tab.wait_for_selector("li:has-text('gaps filled by interpolation in x: 2 values')")
    assert legend(tab, "reading") == ["in the file", "as it is read"]
    tab.wait_for_selector(BEGIN)
    assert faults(tab) == []
    picture(tab, "reading")


@pytest.fixture
def gapped(tab, served, files, tmp_path):
    """A record that lacks one value, uploaded: the page advises how to fill it."""
    lines = (files / "run1.csv").read_text().splitlines()
    time, _, force = lines[801].split(",")
    lines[801] = f"{time},,{force}"
    (tmp_path / "gap.csv").write_text("\n".join(lines) + "\n")
    upload(tab, served, tmp_path / "gap.csv")
    tab.wait_for_selector("#advice button:has-text('record.fill_gaps=1')")
    tab.wait_for_selector(".working", state="detached")
    return tab.locator("#advice button:has-text('fill_gaps')")


def test_a_click_that_ends_the_typing_in_a_field_is_not_lost(tab, gapped):
    """Leaving the field has the record read anew; the message stays under the mouse meanwhile."""
    tab.focus("input[aria-label='unit of force']")
    tab.keyboard.type("N")
    gapped.hover()
    tab.mouse.down()
    tab.wait_for_timeout(400)
    tab.mouse.up()
    tab.wait_for_selector("li:has-text('gaps filled by interpolation in x: 1 value')")
    tab.wait_for_selector(BEGIN)
    assert "force" not in tab.inner_text("#units-taken")  # what was typed counts


def test_nothing_moves_while_a_record_is_read_anew(tab, served, gapped, picture):
    place = gapped.bounding_box()
    with held(served):
        tab.fill("input[aria-label='unit of force']", "N")
        tab.keyboard.press("Tab")
        tab.wait_for_selector(".working:has-text('Reading with this mapping')")
        assert gapped.bounding_box() == place
        picture(tab, "reading-anew")
        tab.set_viewport_size({"width": 390, "height": 900})
        tab.wait_for_function("document.documentElement.scrollWidth <= innerWidth")
        assert faults(tab, ".working") == []
        picture(tab, "reading-anew-phone")
    tab.wait_for_selector(".working", state="detached")


@pytest.mark.slow
def test_a_record_without_an_input_needs_a_mouse_alone(tab, served, files, picture):
    """A free swing: nothing drives it, and but for a rate nothing is typed."""
    upload(tab, served, files / "swing.csv", "pendulum")
    tab.wait_for_selector("main:has-text('Still to choose: a column for torque')")
    choose(tab, "torque", "held at zero")
    tab.wait_for_selector(BEGIN)
    tab.click("text=Rate, gaps and offsets")
    tab.fill("input[aria-label='resample to, Hz']", "50")
    tab.wait_for_selector("main:has-text('at 50 Hz')")
    tab.wait_for_selector("li:has-text('resampled from 100 to 50 Hz')")
    tab.click(".add-effect .q-select >> nth=0")
    tab.click(".q-menu .q-item:has-text('Coulomb friction')")
    tab.click("button:has-text('Put it in'):enabled")
    tab.wait_for_selector("[aria-label='value of Coulomb friction, level']")
    tab.wait_for_selector(BEGIN)
    picture(tab, "desk-model")
    assert faults(tab) == []
    tab.emulate_media(color_scheme="dark")
    assert faults(tab) == []
    tab.click("button[aria-label='Remove Coulomb friction']")
    tab.wait_for_selector("[aria-label='value of Coulomb friction, level']", state="detached")

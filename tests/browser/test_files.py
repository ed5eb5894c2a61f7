"""Files: dropped, looked at, mapped, compared; those that are none are refused with a reason."""

import re

import numpy as np
import pytest

from tests.browser.steps import SECOND, add, choose, error, faults, ready, shows, upload

RATE = 500.0


def softening(time):
    """A spring that gives way, driven five times harder in the part that becomes the test record.

    A cubic spring fitted to the first part pushes outwards beyond it: its free run has no bound.
    """
    from scipy.integrate import solve_ivp

    rng = np.random.default_rng(2)
    tones = [(f, rng.uniform(0, 6.3)) for f in np.arange(1.0, 12.0, 0.6)]

    def force(t):
        return (
            6 * (1 + 4 * (np.asarray(t) > 4.7)) * sum(np.sin(6.283 * f * t + p) for f, p in tones)
        )

    def rate(t, s):
        return [s[1], force(t) - 6 * s[1] - 1000 * s[0] - 60 * np.tanh(s[0] / 0.02)]

    x = solve_ivp(rate, (0, time[-1]), [0, 0], t_eval=time, rtol=1e-8, atol=1e-10, max_step=0.01)
    noisy = x.y[0] + rng.normal(size=len(time)) * 0.01 * x.y[0].std()
    return np.column_stack([time, noisy, force(time)])


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A hardening spring, in columns of the lab's own names; and files that are no record."""
    from scipy.integrate import solve_ivp

    folder = tmp_path_factory.mktemp("files")
    soft = softening(np.arange(3000) / RATE)
    np.savetxt(folder / "soft.csv", soft, "%.9g", delimiter=",", header="t,x,force", comments="")
    time, rng = np.arange(1500) / RATE, np.random.default_rng(1)
    tones = [(f, rng.uniform(0, 6.3)) for f in np.arange(2.0, 20.0, 0.7)]

    def force(t):
        return 12 * sum(np.sin(6.283 * f * t + p) for f, p in tones)

    def rate(t, s):
        return [s[1], force(t) - 6 * s[1] - 4000 * s[0] - 2e6 * s[0] ** 3]

    x = solve_ivp(rate, (0, time[-1]), [0, 0], t_eval=time, rtol=1e-8, atol=1e-10).y[0]
    x += rng.normal(size=len(time)) * 0.01 * x.std()
    rows = np.column_stack([1e3 * time, 1e6 * x, force(time)])
    head = "clock;probe 1;hammer\nms;um;N"
    np.savetxt(folder / "rig.csv", rows, "%.9g", delimiter=";", header=head, comments="")
    (folder / "words.csv").write_text("name,colour\na,red\nb,blue\n")
    (folder / "broken.mat").write_bytes(rng.bytes(2000))
    (folder / "empty.csv").write_text("")
    with (folder / "huge.csv").open("wb") as huge:
        huge.truncate(2 * 10**9)  # sparse: no disk is filled
    return folder


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("words.csv", "no rows of numbers"),
        ("broken.mat", "a MATLAB file"),
        ("empty.csv", "an empty file"),
        ("huge.csv", "a file of 2.00 GB"),
    ],
)
def test_a_bad_file_is_refused_with_a_reason(tab, served, files, picture, name, said):
    tab.goto(served.address)
    tab.wait_for_selector("#drop")
    tab.set_input_files("#drop-file", files / name)
    tab.wait_for_selector(f".trouble:visible:has-text('{said}')")
    text = tab.inner_text(".trouble:visible")
    assert "Expected:" in text
    assert str(served.out) not in text
    again = tab.locator("button:has-text('Read it so')").count()
    assert again == (name == "words.csv")  # no separator makes a text of what is none
    picture(tab, f"refused-{name.split('.')[0]}")


def test_a_column_with_a_text_among_its_numbers_is_told(tab, served, files, picture):
    rows = (files / "rig.csv").read_text().splitlines()
    clock, _, hammer = rows[702].split(";")
    rows[702] = f"{clock};overload;{hammer}"
    (files / "overload.csv").write_text("\n".join(rows))
    upload(tab, served, files / "overload.csv")
    said = tab.inner_text("#left-out")
    assert said.startswith("Left out:\ncolumn 'probe 1' of overload.csv, row 700 (line 703): text ")
    assert "record.rows in Fitted rows" in tab.inner_text("main")  # where the page has it
    assert "probe 1" not in tab.inner_text("table.plain >> nth=0")
    assert faults(tab) == []
    picture(tab, "left-out")


def test_a_file_becomes_a_study(tab, served, files, picture):
    upload(tab, served, files / "rig.csv")
    tab.wait_for_selector(".mapping")
    choose(tab, "time", "clock")
    choose(tab, "x", "hammer")
    choose(tab, "force", "probe 1")
    tab.wait_for_selector(".trouble:visible")  # a position in N
    assert "N" in tab.inner_text(".trouble:visible")
    picture(tab, "mapped-wrongly")
    choose(tab, "x", "probe 1")
    choose(tab, "force", "hammer")
    tab.wait_for_selector("button:has-text('Compare with the model'):enabled")
    assert "1200 samples at 500 Hz" in tab.inner_text("main")
    assert "The last part is kept apart" in tab.inner_text("#apart")
    picture(tab, "mapped")
    tab.click("button:has-text('Compare with the model')")
    tab.wait_for_selector("button[aria-label='Add cubic stiffness']:enabled")


@pytest.mark.slow
def test_a_machine_that_works_in_volts_needs_no_typing_but_its_units(tab, served, files, picture):
    """The message about a unit of another kind offers the setting; a click takes it over."""
    rows = np.loadtxt(files / "rig.csv", delimiter=";", skiprows=2)
    head = "t;out;drive"
    np.savetxt(files / "volts.csv", rows * [1e-3, 1e-3, 1.0], "%.9g", delimiter=";", header=head,
               comments="")  # fmt: skip
    upload(tab, served, files / "volts.csv")
    tab.wait_for_selector(".mapping")
    choose(tab, "x", "out")
    choose(tab, "force", "drive")
    for name, field in (("x", "position_unit"), ("force", "force_unit")):
        tab.wait_for_selector(".working", state="detached")
        tab.click(f"input[aria-label='unit of {name}']")  # as a person, who is in the field then:
        tab.keyboard.type("V")  # a form drawn anew meanwhile leaves it alone
        offer = f"#advice button:has-text(\"Use system.{field}='V'\")"
        tab.wait_for_selector(offer)
        picture(tab, f"volts-{name}")
        tab.click(offer)
        tab.wait_for_selector(offer, state="detached")
    tab.wait_for_selector("button:has-text('Compare with the model'):enabled")
    units = tab.eval_on_selector_all(
        "section:has-text('What was understood') td:last-child", "a => a.map(c => c.innerText)"
    )
    assert units.count("V") == 4  # x and force, fitted and test
    tab.wait_for_selector("svg.sketch:has-text('x (V)'):has-text('force (V)')")
    tab.click("button:has-text('Compare with the model')")
    tab.wait_for_selector("button[aria-label='Add cubic stiffness']:enabled")


def test_what_is_wrong_with_a_file_is_in_view(tab, served, files):
    """Also on a low screen, where the place for files is at the bottom."""
    tab.set_viewport_size({"width": 1280, "height": 640})
    tab.goto(served.address)
    tab.set_input_files("#drop-file", files / "empty.csv")
    tab.wait_for_selector("#drop-trouble:visible")
    tab.wait_for_function(
        "document.querySelector('#drop-trouble').getBoundingClientRect().bottom <= innerHeight"
    )


@pytest.mark.slow
def test_an_effect_of_ones_own_is_tested_at_once(tab, served, picture):
    """On the study of the test before: the formula is found equal to the effect that it writes."""
    tab.goto(served.address)
    tab.click("td a:has-text('rig.csv')")
    tab.wait_for_selector("button[aria-label='Add cubic stiffness']:enabled")
    tab.click("text=Write an effect of your own")
    field = "input[aria-label='Force on the machine']"
    works = tab.get_attribute(field, "placeholder")
    assert works == "-k3*q**3"
    for formula, seen in (
        ("-k3*x**", "#own-trouble:has-text('invalid syntax')"),
        (works, "button[aria-label='Add hardening']:enabled"),
    ):
        tab.fill("input[aria-label='Name']", "hardening")
        tab.fill("input[aria-label='Force on the machine']", formula)
        tab.click("button:has-text('Test it')")
        tab.wait_for_selector(seen)
        tab.wait_for_selector("button[aria-label='Add cubic stiffness']:enabled")
        if formula != works:
            below, above = (tab.locator(s).bounding_box()["y"] for s in ("#own-trouble", field))
            assert 0 < below - above < 300  # beside the field, not at the top of the page
    assert tab.locator("#own-trouble").count() == 0
    picture(tab, "own-effect")
    tab.click("button[aria-label='Add hardening']:enabled")
    tab.wait_for_selector(".chip.added:has-text('hardening')")


@pytest.mark.slow
def test_aliases_are_compared_side_by_side(tab, served, picture):
    """On the same study, from its seed: the effect and the formula that is equal to it."""
    tab.goto(served.address)
    tab.click("td a:has-text('rig.csv')")
    tab.click("button:has-text('Undo'):enabled")
    tab.click("button:has-text('Compare them'):enabled")
    tab.wait_for_selector(".alike table")
    rows = tab.eval_on_selector_all(".alike tr", "all => all.map(r => r.innerText.split('\\t'))")
    assert sorted(rows[0][1:]) == ["cubic stiffness", "hardening"]
    assert [rows[1][0], rows[3][0]] == ["next sample", "free run"]
    assert re.fullmatch(r"0\.\d+ s ahead", rows[2][0])
    assert rows[-1][0].startswith("χ²/dof, over ")
    same = [one == other for _, one, other in rows[1:-1]]  # to the digits shown
    assert all(same), rows
    assert float(rows[-1][1]) == pytest.approx(float(rows[-1][2]), rel=0.002)
    picture(tab, "aliases-compared")
    tab.click("button:has-text('Which test tells'):enabled")
    tab.wait_for_selector("#plan table")
    told = tab.inner_text("#plan")
    assert "the record at hand" in told
    assert "No planned test reaches 95%" in told  # one effect under two names
    assert "cubic_stiffness" not in told
    assert "plan." not in told  # settings of the command line are a field here
    tab.wait_for_selector("button:has-text('Plan again'):enabled")  # drawn anew as the plan ends
    tab.fill("input[aria-label='Lengths to try, s']", "0")
    tab.click("button:has-text('Plan again'):enabled")
    tab.click(".q-notification:has-text('numbers above zero') button:has-text('Close')")
    tab.fill("input[aria-label='Lengths to try, s']", "1.5")
    tab.click("button:has-text('Plan again'):enabled")
    tab.wait_for_selector("#plan td:has-text('1.5 s')")
    assert tab.get_attribute("input[aria-label='Lengths to try, s']", "placeholder") == "1.5"
    picture(tab, "planned")
    tab.wait_for_selector("button:has-text('Compare them'):enabled")
    tab.click("button:has-text('Compare them'):enabled")
    tab.wait_for_selector(".alike table")
    tab.click(".alike button:has-text('Add hardening'):enabled")
    tab.wait_for_selector(".chip.added:has-text('hardening')")


@pytest.mark.slow
def test_a_model_that_runs_away_loses_nothing(tab, served, files, picture):
    upload(tab, served, files / "soft.csv")
    tab.click("button:has-text('Compare with the model'):enabled")
    ready(tab, SECOND)
    before = error(tab)
    add(tab, SECOND)
    tab.wait_for_selector("#astray:has-text('With cubic stiffness the model runs away')")
    assert "not finite" in tab.inner_text("#error-now")
    tab.wait_for_selector("button:has-text('Undo'):enabled")
    picture(tab, "ran-away")
    tab.click("button:has-text('Undo')")
    shows(tab, before)
    tab.wait_for_selector("#plot-free_run .main-svg")  # all has been drawn: nothing moves any more
    tab.locator("button", has_text=re.compile(r"Show \d+ more")).click()
    add(tab, "quadratic stiffness")
    tab.wait_for_selector(".chip.added:has-text('quadratic stiffness')")
    assert error(tab)[-1] == before[0]
    assert "+ cubic stiffness: not finite" in tab.inner_text("#branches")  # no branch is lost


def test_an_address_that_names_nothing_says_so(tab, served):
    tab.goto(f"{served.address}/study/20200101-000000-abc")
    assert "a study" in tab.inner_text(".trouble")

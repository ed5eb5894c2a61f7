"""Models that files of Python define."""

import json
import textwrap

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import spiral
from spiral.commands.perform import perform
from spiral.io.request import Request
from spiral.types.errors import ConfigError

MODEL = """
    import spiral
    from beside import STIFFNESS

    def rhs(t, x, u, p):
        return [x.v, (u.F - p.c * x.v - p.k * x.x) / p.m]

    print("told")
    system = spiral.system(
        rhs, states={"x": "m", "v": "m/s"}, inputs={"F": "N"}, observed=["x"],
        parameters={"m": (1.0, "kg"), "c": (2.0, "N*s/m"), "k": (STIFFNESS, "N/m")}, free=["k"],
    )
    if __name__ == "__main__":
        raise SystemExit("a script")
"""


@pytest.fixture(name="written")
def _written(tmp_path, monkeypatch):
    """Writes ``machine.py`` into the folder that commands are called in."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "beside.py").write_text("STIFFNESS = 90.0\n")

    def write(text):
        (tmp_path / "machine.py").write_text(textwrap.dedent(text))
        return "machine.py"

    return write


def _perform(verb, *overrides, names=()):
    request = Request(verb, names, ("tracking=none", *overrides))
    return perform(request, lambda message: None)


def _refused(verb="compare", *overrides):
    with pytest.raises(ConfigError) as error:
        _perform(verb, "system=machine.py", "record.path=r.csv", *overrides)
    return error.value


def _write_record(folder):
    """The machine with k = 80 N/m under a chirp, 1 % noise."""
    time = np.arange(1500) * 0.02
    force = np.sin(0.2 * time**2)
    slope = lambda t, x: [x[1], np.interp(t, time, force) - 2 * x[1] - 80 * x[0]]  # noqa: E731
    x = solve_ivp(slope, (0, time[-1]), [0, 0], t_eval=time, max_step=0.02, rtol=1e-8).y[0]
    x += 0.01 * x.std() * np.random.default_rng(0).normal(size=x.size)
    table = np.c_[time, x, force]
    np.savetxt(folder / "r.csv", table, delimiter=",", header="t [s],x [m],F [N]", comments="")


def test_a_command_takes_the_system_of_a_file_and_a_saved_run_holds_its_equations(
    written, tmp_path, capsys
):
    written(MODEL)
    _write_record(tmp_path)
    first = _perform("compare", "system=machine.py", "record.path=r.csv", "record.time=t")
    out, err = capsys.readouterr()
    assert "told" in err
    assert "told" not in out
    (tmp_path / "machine.py").unlink()
    saved = json.loads(next((tmp_path / "runs").glob("*/run.json")).read_text())
    assert "machine.py" not in json.dumps(saved["config"]["system"])
    again = _perform("compare", "run=latest")
    assert again.result["fit_error"] == pytest.approx(first.result["fit_error"], rel=1e-3)
    assert first.result["fit_error"] < 0.02


def test_check_and_python_take_the_same_file(written):
    file = written(MODEL)
    assert _check(file)["passed"]
    assert spiral.system(file).text == spiral.system("machine.py").text
    with pytest.raises(ConfigError, match="the file alone"):
        spiral.system(file, observed=["v"])


def _check(file):
    return perform(Request("check", (file,), ()), lambda message: None).result


@pytest.mark.parametrize(
    ("text", "given"),
    [
        ("x = 1 / 0\n", "machine.py, line 1: ZeroDivisionError: division by zero"),
        ("x = 1\ny = (\n", "machine.py, line 2: SyntaxError: '(' was never closed"),
        ("import sys\nsys.exit(3)\n", "machine.py, line 2: SystemExit: 3"),
        ("x = 3\n", "machine.py: no system"),
        ("system = 'model.yaml'\n", "machine.py: no system, system is a str"),
    ],
)
def test_a_file_without_a_system_is_answered_with_the_line_that_fails(written, text, given):
    written(text)
    error = _refused()
    assert error.given == given
    assert "system = spiral.system(rhs" in error.expected


def test_two_systems_are_told_apart_by_the_name_system(written):
    one = "spiral.system(['x\\' = -k*x'], states={'x': 'm'}, parameters={'k': '1 1/s'}, observed=['x'])"  # noqa: E501
    two = one.replace("1 1/s", "2 1/s")
    written(f"import spiral\na = {one}\nb = {two}\n")
    assert _refused().given == "machine.py: 2 systems (a, b)"
    written(f"import spiral\na = {one}\nsystem = {two}\n")
    assert "2 1/s" in spiral.system("machine.py").text
    written(f"import spiral\na = {one}\n")
    assert "1 1/s" in spiral.system("machine.py").text


def test_a_function_that_no_run_can_hold_is_refused_with_its_line(written):
    written(MODEL.replace("p.k * x.x)", "p.k * (x.x if x.x > 0 else 0))"))
    error = _refused()
    assert "a decision by x > 0" in error.given
    assert "python machine.py" in error.try_


def test_a_class_of_its_own_belongs_into_the_folder_of_plugins(written):
    written("""
        from spiral_plugins.systems.oscillator import Oscillator

        class Mine(Oscillator):
            pass

        system = Mine()
    """)
    assert "a class of its own" in _refused().given


def test_a_file_that_is_not_there_is_said_to_be_missing(written):
    assert _refused().expected == "a file that is there"


def test_a_file_that_the_command_does_not_name_is_not_run(written, tmp_path):
    """A preset's or a run's configuration may come from anywhere."""
    from spiral.io.config import compose
    from spiral.io.registry import load_registry

    written("open('ran', 'w').close()\n")
    with pytest.raises(ConfigError, match="names"):
        compose(("system=machine.py",), load_registry())
    assert not (tmp_path / "ran").exists()

"""``spiral new`` writes what passes ``spiral check`` and its own test; both refuse readably."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import spiral.io.writing
from spiral.cli import main
from spiral.io.scaffold import KINDS

SPRING = '''
from spiral.types.effect import ForceEffect
from spiral.types.parameter import Parameter


class {name}(ForceEffect):
    """A spring: F = -k q."""

    parameters = (Parameter("stiffness", "{unit}"),)

    def force(self, at, u, p):
        return [-p.stiffness * q for q in at.position]
'''


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.delenv("SPIRAL_PLUGINS", raising=False)
    return tmp_path


def run_json(capsys, *words):
    code = main([*words, "--json", "-"])
    return code, json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("kind", KINDS)
def test_a_skeleton_passes_its_check_unedited(capsys, kind):
    name = f"own_{kind}"
    code, written = run_json(capsys, "new", kind, name)
    assert (code, written["files"]) == (0, [f"plugins/{name}.py", f"plugins/test_{name}.py"])
    code, found = run_json(capsys, "check", name)
    assert (code, found["passed"]) == (0, True)
    assert all(c["passed"] and c["seen"] for c in found["plugins"][0]["checks"])
    code, listed = run_json(capsys, "plugins", name)
    assert (code, listed["plugins"][0]["origin"]) == (0, "local")


def test_every_skeleton_passes_its_own_test_unedited():
    """In one process: most of the time of a process is spent on imports."""
    for kind in KINDS:
        assert main(["new", kind, f"own_{kind}"]) == 0
    command = [sys.executable, "-m", "pytest", "-v", "-p", "no:cacheprovider", "plugins"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    passed = set(re.findall(r"plugins/(test_\w+\.py)::.* PASSED", done.stdout))
    assert passed == {f"test_own_{kind}.py" for kind in KINDS}


def test_a_skeleton_goes_where_plugins_says(capsys, place, monkeypatch):
    assert main(["new", "effect", "own_spring", "--plugins", "deep/mine"]) == 0
    assert "spiral check own_spring --plugins deep/mine" in capsys.readouterr().out
    monkeypatch.setenv("SPIRAL_PLUGINS", "elsewhere")
    assert main(["new", "effect", "other_spring"]) == 0
    files = sorted(str(f.relative_to(place)) for f in place.rglob("*.py"))
    assert files == [
        "deep/mine/own_spring.py",
        "deep/mine/test_own_spring.py",
        "elsewhere/other_spring.py",
        "elsewhere/test_other_spring.py",
    ]


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["effct", "own_spring"], "'effect'"),
        (["lerner", "own_learner"], "system, effect, source"),
        (["effect"], "spiral new effect my_spring"),
        (["effect", "one", "two"], "spiral new KIND NAME"),
        (["effect", "own_spring", "port=disk"], "spiral new KIND NAME"),
        (["effect", "MySpring"], "spiral new effect my_spring"),
        (["effect", "my-spring"], "spiral new effect my_spring"),
        (["effect", "../spring"], "spiral new effect spring"),
        (["effect", "1spring"], "spiral new effect spring"),
        (["effect", "pt_100"], "spiral new effect pt100"),
        (["effect", "lambda"], "snake_case"),
        (["effect", "test_spring"], "spiral new effect spring"),
        (["effect", "parameter"], "my_parameter"),
        (["effect", "json"], "my_json"),
        (["effect", "cubic_stiffness"], "spiral check cubic_stiffness"),
        (["effect", "oscillator"], "spiral check oscillator"),
    ],
)
def test_what_cannot_be_a_new_plugin_is_refused_and_leaves_nothing(capsys, place, words, hint):
    assert main(["new", *words]) == 2
    told = capsys.readouterr()
    assert "given:" in told.err
    assert hint in told.err
    assert list(place.iterdir()) == []


def test_a_near_name_is_pointed_out(capsys):
    code, written = run_json(capsys, "new", "effect", "cubic_stifness")
    assert (code, written["similar"][0]) == (0, "cubic_stiffness")


@pytest.mark.parametrize("name", ["own_spring.py", "test_own_spring.py"])
def test_nothing_is_overwritten(capsys, place, name):
    (place / "plugins").mkdir()
    (place / "plugins" / name).write_text("# mine\n")
    assert main(["new", "effect", "own_spring"]) == 2
    assert f"plugins/{name} exists" in capsys.readouterr().err
    assert [f.name for f in (place / "plugins").iterdir()] == [name]
    assert (place / "plugins" / name).read_text() == "# mine\n"


def test_nothing_half_written_remains(capsys, place, monkeypatch):
    whole = spiral.io.writing.write_whole

    def full(file: Path, text: str):
        if file.name.startswith("test_"):
            raise OSError(28, "No space left on device")
        whole(file, text)

    monkeypatch.setattr(spiral.io.writing, "write_whole", full)
    assert main(["new", "effect", "own_spring"]) == 2
    assert "No space left" in capsys.readouterr().err
    assert list(place.iterdir()) == []
    (place / "plugins").write_text("a file in the way")
    assert main(["new", "effect", "own_spring"]) == 2
    assert "plugins" in capsys.readouterr().err


def test_a_failed_check_is_exit_2_with_what_to_try(capsys, place):
    (place / "plugins").mkdir()
    text = SPRING.format(name="OwnSpring", unit="force/position^2")
    (place / "plugins" / "own.py").write_text(text)
    code, result = run_json(capsys, "check", "own_spring")
    assert (code, result["passed"]) == (2, False)
    assert set(result["error"]) == {"given", "expected", "try"}
    assert "own.py" in result["error"]["given"]
    assert "effect 'own_spring' gives N/m; expected N" in result["error"]["given"]
    assert main(["check", "own_spring"]) == 2
    out = capsys.readouterr().out
    assert "failed" in out
    assert "try:" in out
    assert re.search(r"own_spring: 8[1-3] of 90 checks passed", out)


def test_several_plugins_are_checked_at_once(capsys):
    code, result = run_json(capsys, "check", "pendulum", "gravity_torque")
    assert code == 0
    assert [p["name"] for p in result["plugins"]] == ["pendulum", "gravity_torque"]
    assert {c["on"] for c in result["plugins"][1]["checks"]} == {
        "gravity_torque on pendulum", "gravity_torque on robot",
    }  # fmt: skip
    assert main(["check", "pendulum"]) == 0
    assert "12 of 12 checks passed" in capsys.readouterr().out


def test_a_model_is_checked_by_its_file_or_as_it_is_chosen(capsys, place):
    text = "equations: [\"m*x'' + c*x' + k*x = F\"]\nstates: {x: m}\ninputs: {F: N}\n"
    text += "parameters: {m: 2 kg, c: 1 N*s/m, k: 400 N/m}\nobserved: [x]\n"
    (place / "bench.yaml").write_text(text)
    (place / "wrong.yaml").write_text(text.replace("1 N*s/m", "1 N/m"))
    for words in (["bench.yaml"], ["system=bench.yaml"], ["pendulum", "system.torque_unit=N*m"]):
        code, result = run_json(capsys, "check", *words)
        assert (code, result["passed"]) == (0, True)
        names = [c["check"] for c in result["plugins"][0]["checks"]]
        assert len(names) == 12 - ("docstring" not in names)
        assert ("docstring" in names) == (words[0] == "pendulum")  # a file has none
    told = {c["check"]: c["seen"] for c in result["plugins"][0]["checks"]}
    assert "torque" in told["declares"]
    assert run_json(capsys, "check", "bench.yaml")[1]["plugins"][0]["name"] == "bench.yaml"
    assert "terms of one unit" in run_json(capsys, "check", "wrong.yaml")[1]["error"]["expected"]
    assert "no.yaml" in run_json(capsys, "check", "no.yaml")[1]["error"]["given"]


def test_records_that_are_named_are_read_and_told(capsys, place):
    """A file that is not there, or a column of another name, is no check that passed."""
    text = "equations: [\"m*x'' + c*x' + k*x = F\"]\nstates: {x: {unit: m, start: 0.5}}\n"
    text += "inputs: {F: {unit: N, interpolation: zero_order}}\nobserved: [x]\n"
    text += "parameters: {m: 2 kg, c: 1 N*s/m, k: {value: 400, unit: N/m}}\nfree: [k]\n"
    (place / "bench.yaml").write_text(text)
    rows = [f"{0.01 * k:.2f},{np.sin(0.1 * k):.6f},{k % 7}" for k in range(200)]
    (place / "run.csv").write_text("t,x,F\n" + "\n".join(rows) + "\n")
    words = ["system=bench.yaml", "record.path=run.csv", "record.time=t"]
    code, result = run_json(capsys, "check", *words)
    told = {c["check"]: c["seen"] for c in result["plugins"][0]["checks"]}
    assert code == 0
    assert told["record"].startswith("run.csv: 200 samples, 2 s, 100 Hz. ")
    assert told["declares"] == (
        "free: k 400; known: m 2, c 1; begins near: x 0.5; F: held until the next sample"
    )
    code, result = run_json(capsys, "check", *words[:2], "record.time=zeit")
    assert code == 2
    assert "zeit" in result["error"]["given"]
    code, result = run_json(capsys, "check", words[0], "record.path=ran.csv", words[2])
    assert (code, result["error"]["try"]) == (2, "did you mean run.csv?")


def test_unknown_and_unusable_names_are_told(capsys, place):
    (place / "plugins").mkdir()
    (place / "plugins" / "own.py").write_text("1 / 0")
    for words, hint in (
        (["check"], "spiral check NAME"),
        (["check", "cubic_stifness"], "'cubic_stiffness'"),
        (["check", "own"], "own.py could not be used: ZeroDivisionError"),
        (["check", "pendulum", "system.torque_unot=N"], "torque_unit"),
    ):
        assert main(words) == 2
        assert hint in capsys.readouterr().err

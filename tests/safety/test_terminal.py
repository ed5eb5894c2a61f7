"""What is printed and saved: no password in it, no traceback from it, nobody else's to read."""

import json
import os
import stat
import subprocess
import sys

import pytest

from spiral import cli
from spiral.app import viewer
from spiral.io.registry import load_registry
from spiral.io.request import Request
from spiral.io.storage import save_result
from spiral.io.tracking.store import Tracking
from spiral.io.writing import write_whole
from spiral.types import kernel_cache
from spiral.types.errors import InputError
from spiral.types.masking import without_passwords
from spiral.view.terminal.parts import request_command

SPIRAL = [sys.executable, "-m", "spiral"]


@pytest.mark.parametrize(
    ("given", "shown"),
    [
        ("postgresql+psycopg://me:pw@db:5432/mlflow", "postgresql+psycopg://me:***@db:5432/mlflow"),
        ("postgresql://db/mlflow?user=me&password=pw", "postgresql://db/mlflow?user=me&password=***"),
        ("http://me:p@w@host:5000/", "http://me:***@host:5000/"),
        ("tracking.uri='mysql://me:pw@h/d?ssl=1&passwd=x'",
         "tracking.uri='mysql://me:***@h/d?ssl=1&passwd=***'"),
        ("https://host/?token=abc#top", "https://host/?token=***#top"),
        ("sqlite:///runs/mlflow.db", "sqlite:///runs/mlflow.db"),
        ("http://127.0.0.1:5000", "http://127.0.0.1:5000"),
        ("record.units='{x: m/s}'", "record.units='{x: m/s}'"),
    ],
)  # fmt: skip
def test_passwords_of_addresses_are_masked(given, shown):
    assert without_passwords(given) == shown


URI = "postgresql://me:hush@db/mlflow?password=hush"


def test_no_password_is_printed_or_saved(question, tmp_path):
    """``tracking.uri=...`` stood under "Next" and in run.json."""
    config, problem = question
    given = (f"tracking.uri={URI}", "holdout=0.3")
    told = {**config, "tracking": {**config["tracking"], "uri": URI}}
    registry = load_registry(local=False)
    run = save_result("compare", {}, problem.model, told, {}, registry, tmp_path, given)
    text = (tmp_path / run / "run.json").read_text()
    assert "hush" not in text
    assert json.loads(text)["overrides"][1] == "holdout=0.3"
    assert "hush" not in request_command("compare", Request("compare", overrides=given))
    assert "hush" not in Tracking(uri=URI).page("runs")
    assert Tracking(uri=URI).resolve_uri("runs") == URI  # what is used is whole


def test_mlflows_page_is_given_the_password_where_no_list_of_processes_shows_it(monkeypatch):
    started = {}

    class Ended:
        def __init__(self, command, env, **more):
            started.update(command=command, env=env)

        def poll(self):
            return 1

        def terminate(self):
            pass

    monkeypatch.setattr(viewer.subprocess, "Popen", Ended)
    with pytest.raises(InputError) as caught:
        viewer.Viewer().address(URI, "experiments/1/runs/2")
    assert started["env"]["MLFLOW_BACKEND_STORE_URI"] == URI
    assert "hush" not in " ".join(started["command"])
    assert "hush" not in str(caught.value)


@pytest.mark.parametrize(("mask", "mode"), [(0o077, 0o600), (0o022, 0o644), (0o027, 0o640)])
def test_files_are_as_open_as_the_umask_says(tmp_path, mask, mode):
    before = os.umask(mask)
    try:
        write_whole(tmp_path / "a.json", "{}")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.json").stat().st_mode) == mode


@pytest.mark.parametrize("words", [["plugins"], ["plugins", "--json", "-"], ["--help"]])
def test_a_reader_that_has_seen_enough_is_no_failure(tmp_path, words):
    """``spiral plugins | head -1`` ended with exit 1."""
    program = subprocess.Popen(
        [*SPIRAL, *words], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    program.stdout.close()  # before the first line
    assert program.stderr.read() == ""
    assert program.wait(60) == 0


def test_a_terminal_that_knows_few_letters_gets_a_table_and_whole_json(tmp_path):
    environment = {**os.environ, "PYTHONIOENCODING": "ascii", "LC_ALL": "C"}
    shown = {"cwd": tmp_path, "env": environment, "capture_output": True, "check": False}
    words = ["compare", "experiment=rotor_coastdown", "record.duration=2", "curves=false"]
    done = subprocess.run([*SPIRAL, *words, "tracking.enabled=false"], **shown)
    assert b"Traceback" not in done.stderr
    assert done.returncode == 0
    assert b"?" in done.stdout  # in place of what it cannot show
    done = subprocess.run([*SPIRAL, "compare", "experiment=größe", "--json", "-"], **shown)
    assert done.returncode == 2
    assert "größe" in json.loads(done.stdout)["error"]["given"]


@pytest.mark.parametrize("limit", [600_000_000, 200_000_000])
def test_too_little_memory_to_start_is_one_message(tmp_path, limit):
    """Importing ended in a traceback, or OpenBLAS in words of its own."""
    resource = pytest.importorskip("resource")
    words = ["compare", "experiment=rotor_coastdown", "--json", "-"]
    done = subprocess.run(
        [*SPIRAL, *words], cwd=tmp_path, capture_output=True, text=True, check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)),
    )  # fmt: skip
    assert done.returncode == 2
    assert "ulimit -v" in json.loads(done.stdout)["error"]["given"]
    assert "Traceback" not in done.stderr


def test_memory_that_runs_out_later_is_one_message(monkeypatch, capsys):
    def perform(*given):
        raise MemoryError

    monkeypatch.setattr(cli, "perform", perform)
    assert cli.main(["compare", "experiment=rotor_coastdown"]) == 2
    assert "more memory than there is" in capsys.readouterr().err


def test_kernels_are_kept_where_nobody_else_can_write(tmp_path, monkeypatch):
    """Neither the package nor the home can be written: Numba ended in a traceback."""
    monkeypatch.setattr(kernel_cache, "_is_writable", lambda folder: False)
    monkeypatch.setattr(kernel_cache.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setenv(kernel_cache.VARIABLE, "")  # so that what is set here does not stay
    monkeypatch.delenv(kernel_cache.VARIABLE)
    kernel_cache.provide(tmp_path)
    folder = tmp_path / f"spiral-kernels-{os.getuid()}"
    assert os.environ[kernel_cache.VARIABLE] == str(folder)
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert kernel_cache.private_folder(tmp_path) == folder
    folder.chmod(0o770)
    assert kernel_cache.private_folder(tmp_path) != folder  # others may have written there
    folder.rmdir()
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    folder.symlink_to(tmp_path / "elsewhere")
    other = kernel_cache.private_folder(tmp_path)
    assert stat.S_IMODE(other.stat().st_mode) == 0o700
    assert not other.is_symlink()
    assert other != folder


def test_a_users_own_choice_of_a_cache_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_cache, "_is_writable", lambda folder: False)
    monkeypatch.setenv(kernel_cache.VARIABLE, "own")
    kernel_cache.provide(tmp_path)
    assert os.environ[kernel_cache.VARIABLE] == "own"

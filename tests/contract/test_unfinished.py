"""A study killed at any moment loses at most the round under way."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace

import pytest

from spiral.cli import main
from spiral.inference.discover import Checkpoint, discover
from spiral.io import checkpoint, storage
from spiral.io.checkpoint import FILE, FOLDER, CheckpointStore, checkpoint_keeper, study_fingerprint
from spiral.io.config import build_problem, compose
from spiral.io.registry import load_registry
from spiral.io.writing import to_json
from spiral.types.errors import InputError

REGISTRY = load_registry()
GIVEN = (
    "experiment=rotor_coastdown", "record.duration=1", "test.duration=1", "settings.max_rounds=3",
    "candidates=[cross_stiffness,cubic_stiffness,gyroscopic]",
)  # fmt: skip
UNTIMED = {"seconds"}


@pytest.fixture(scope="module")
def study():
    """A study with the checkpoints that it kept on its way."""
    config = compose(GIVEN, REGISTRY)
    problem = build_problem(config, REGISTRY)
    kept: list[Checkpoint] = []
    return config, problem, discover(problem, keep=kept.append), kept


def untimed(value):
    if isinstance(value, dict):
        return {k: untimed(v) for k, v in value.items() if k not in UNTIMED | {"run_id"}}
    return [untimed(v) for v in value] if isinstance(value, list) else value


def as_json(run):
    return untimed(json.loads(to_json(run.as_dict())))


def test_a_study_taken_up_ends_as_if_it_had_never_stopped(study, tmp_path):
    _, problem, run, kept = study
    assert [len(c.rounds) for c in kept] == [1, 2, 3, 4]
    other = CheckpointStore(tmp_path, REGISTRY)
    other.write(kept[2])
    taken_up = other.read_last()
    assert taken_up is not None
    assert as_json(discover(problem, resume=taken_up)) == as_json(run)


def test_only_the_same_study_is_taken_up(study):
    config, problem, _, _ = study
    own = study_fingerprint(config, problem, REGISTRY)
    assert study_fingerprint({**config, "out": "elsewhere", "n_jobs": 1}, problem, REGISTRY) == own
    settings = {**config["settings"], "level": 0.02}
    assert study_fingerprint({**config, "settings": settings}, problem, REGISTRY) != own
    shorter = replace(problem, records=(problem.records[0].part(0, 700, "shorter"),))
    assert study_fingerprint(config, shorter, REGISTRY) != own


def test_a_damaged_checkpoint_is_no_checkpoint(study, tmp_path):
    other = CheckpointStore(tmp_path, REGISTRY)
    other.write(study[3][0])
    text = (tmp_path / FILE).read_text()
    (tmp_path / FILE).write_text(text[: len(text) // 2])
    assert other.read_last() is None


def test_a_twin_that_runs_at_the_same_time_keeps_nothing(study, tmp_path):
    config, problem, _, kept = study
    with checkpoint_keeper(config, problem, REGISTRY, tmp_path) as first:
        first.write(kept[0])
        with checkpoint_keeper(config, problem, REGISTRY, tmp_path) as second:
            assert second.read_last() is None
            second.write(kept[1])
        assert len(first.read_last().rounds) == 1
        first.remove()
    assert not (tmp_path / FOLDER).exists()


def test_a_full_disk_is_said_and_what_was_written_stays(study, tmp_path, monkeypatch):
    def full(file, text):
        raise OSError(28, "No space left on device")

    other = CheckpointStore(tmp_path, REGISTRY)
    other.write(study[3][0])
    monkeypatch.setattr(checkpoint, "write_whole", full)
    with pytest.raises(InputError, match="No space left"):
        other.write(study[3][1])
    assert len(other.read_last().rounds) == 1


@pytest.mark.slow
def test_killed_in_the_middle_and_started_again(study, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = [*GIVEN, "tracking.enabled=false"]
    process = subprocess.Popen(
        [sys.executable, "-m", "spiral", "discover", *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    _wait(lambda: _rounds_kept(tmp_path) >= 2, process)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not storage.run_ids("runs")  # nothing half-written
    assert main(["discover", *words, "--json", "-"]) == 0
    out, said = capsys.readouterr()
    assert "taking up this study" in said
    assert untimed(json.loads(out)) == as_json(study[2])
    assert not (tmp_path / "runs" / FOLDER).exists()


def test_a_signal_leaves_the_checkpoint_and_no_lock(tmp_path):
    """And locks that processes killed earlier left go with the next start."""
    left = tmp_path / "runs" / FOLDER
    left.mkdir(parents=True)
    (left / "0123456789.lock").touch()
    os.utime(left / "0123456789.lock", (0, 0))
    words = [*GIVEN, "tracking.enabled=false"]
    process = subprocess.Popen(
        [sys.executable, "-m", "spiral", "discover", *words, "--json", "result.json"],
        cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    _wait(lambda: _rounds_kept(tmp_path) >= 1, process)
    process.send_signal(signal.SIGTERM)
    said = process.communicate()[1]
    assert "Traceback" not in said
    assert re.search(r"After round \d: (No candidate was confirmed until then|Missing was)", said)
    assert said.rstrip().endswith("The same command goes on from there.")
    assert process.returncode == 128 + signal.SIGTERM
    assert _rounds_kept(tmp_path) >= 1
    assert not list(left.glob("*.lock"))
    result = json.loads((tmp_path / "result.json").read_text())
    assert result["error"]["given"].startswith("a study that was stopped after round ")
    assert result["summary"]
    assert len(result["rounds"]) == _rounds_kept(tmp_path)


def test_a_study_stopped_as_it_keeps_a_round_leaves_its_result(tmp_path, monkeypatch):
    """The checkpoint is written first; the file of results must not need the moment after."""
    monkeypatch.chdir(tmp_path)
    write = CheckpointStore.write

    def stopped_while_writing(self, at):
        write(self, at)
        raise KeyboardInterrupt

    monkeypatch.setattr(CheckpointStore, "write", stopped_while_writing)
    words = [*GIVEN, "tracking.enabled=false", "--json", "result.json"]
    assert main(["discover", *words]) == 128 + signal.SIGINT
    result = json.loads((tmp_path / "result.json").read_text())
    assert result["error"]["given"] == "a study that was stopped after round 0"
    assert len(result["rounds"]) == _rounds_kept(tmp_path) == 1


def _rounds_kept(folder):
    for file in (folder / "runs" / FOLDER).glob(f"*/{FILE}"):
        return len(json.loads(file.read_text())["rounds"])
    return 0


def _wait(reached, process, seconds=120.0):
    end = time.monotonic() + seconds
    while not reached():
        assert process.poll() is None, "the study ended before it could be killed"
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.skipif(
    os.geteuid() != 0 or shutil.which("mount") is None, reason="needs root to mount a small disk"
)
def test_a_disk_that_is_really_full(tmp_path, monkeypatch, capsys):
    small = tmp_path / "small"
    small.mkdir()
    made = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=16k", "tmpfs", str(small)], capture_output=True
    )
    if made.returncode:
        pytest.skip("no small disk can be mounted here")
    try:
        (small / "filler").write_bytes(b"x" * 12_000)
        code = main(["compare", *GIVEN[:2], f"out={small}"])
        assert code == 2
        assert "No space left" in capsys.readouterr().err
        assert not list(small.rglob("*.tmp"))
        assert (small / "filler").stat().st_size == 12_000
    finally:
        subprocess.run(["umount", str(small)], check=True)

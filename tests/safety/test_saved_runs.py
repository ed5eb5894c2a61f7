"""A run folder from anywhere: nothing it names is run, obeyed or sent."""

import hashlib
import json
import shutil
import subprocess
import zipfile

import numpy as np
import pytest

import spiral
from spiral.io.config import build_system
from spiral.io.curves import FILE as CURVES
from spiral.io.curves import read_curves
from spiral.io.registry import load_registry
from spiral.io.request import Request, compose_request
from spiral.io.storage import FILE, load_run, read_run, run_ids
from spiral.io.tracking.store import Tracking, import_mlflow, open_store
from spiral.io.tracking.track import track
from spiral.types.errors import ConfigError, InputError
from tests.safety.conftest import saved

EVIL_FMU = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="evil" guid="1">
<ModelExchange modelIdentifier="evil"/><ModelVariables>
<ScalarVariable name="x" valueReference="0"><Real start="0"/></ScalarVariable>
<ScalarVariable name="der(x)" valueReference="1"><Real derivative="1"/></ScalarVariable>
</ModelVariables><ModelStructure><Derivatives><Unknown index="2"/></Derivatives>
</ModelStructure></fmiModelDescription>
"""


@pytest.fixture(scope="module")
def empty_store(tmp_path_factory):
    """A store that was made and migrated, to be copied."""
    folder = tmp_path_factory.mktemp("store")
    with open_store(Tracking(experiment="another"), folder):
        pass
    return folder / "mlflow.db"


@pytest.fixture
def out(tmp_path, empty_store, monkeypatch):
    """A folder of runs with a store of its own, and no other that the environment names."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    (tmp_path / "runs").mkdir()
    shutil.copy(empty_store, tmp_path / "runs" / "mlflow.db")
    return tmp_path / "runs"


def changed(folder, **values):
    """The saved run with other values, as somebody else may write them."""
    data = json.loads((folder / FILE).read_text())
    (folder / FILE).write_text(json.dumps({**data, **values}))


def logged(out):
    """The run that MLflow knows, and the paths of all that was logged with it."""
    import_mlflow()
    from mlflow import MlflowClient

    client = MlflowClient(tracking_uri=f"sqlite:///{out / 'mlflow.db'}")
    number = client.get_experiment_by_name("spiral").experiment_id
    (run,) = client.search_runs([number], "tags.`spiral.verb` = 'discover'")
    paths = [p for p in out.glob("artifacts/**/*") if p.is_file()]
    return run, paths


def own_registry(folder, plugin):
    """Plugins with a local one, which is run for it."""
    folder.mkdir(exist_ok=True)
    (folder / "own.py").write_text(plugin)
    return load_registry(folder)


@pytest.mark.hostile("saved runs")
@pytest.mark.parametrize("named", [["EVIL"], {"EVIL": "EVIL"}])
def test_a_plugin_file_that_a_run_names_is_neither_run_nor_logged(
    question, out, tmp_path, plugin, trace, named
):
    """``local_plugins: [FILE]`` in a downloaded run.json was executed by whatever came next."""
    evil = tmp_path / "evil.py"
    evil.write_text(plugin)
    folder = saved(question, out)
    text = json.dumps(named).replace("EVIL", str(evil))
    changed(folder, local_plugins=json.loads(text))
    assert track(Tracking(), out).failure is None
    assert not trace.exists()
    assert not any("own_spring" in p.name or "evil" in p.name for p in logged(out)[1])


@pytest.mark.hostile("saved runs")
def test_a_program_that_a_run_names_is_not_run(question, out, tmp_path, trace):
    """An FMU beside a downloaded run: its library says where it is loaded, and is not."""
    compiler = shutil.which("gcc")
    if compiler is None:
        pytest.skip("no gcc here")
    opens = f'__attribute__((constructor)) void f(void) {{ fclose(fopen("{trace}", "w")); }}'
    (tmp_path / "evil.c").write_text(f"#include <stdio.h>\n{opens}\n")
    library = tmp_path / "evil.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, tmp_path / "evil.c"], check=True)
    with zipfile.ZipFile(tmp_path / "evil.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", EVIL_FMU)
        archive.write(library, "binaries/linux64/evil.so")
        archive.write(library, "binaries/x86_64-linux/evil.so")
    folder = saved(question, out)
    data = json.loads((folder / FILE).read_text())
    system = {"name": "fmu", "path": str(tmp_path / "evil.fmu"), "measured": ["x"]}
    data["model"]["system"] = data["config"]["system"] = system
    (folder / FILE).write_text(json.dumps(data))
    registry = load_registry()
    with pytest.raises(ConfigError, match="runs with your rights"):
        load_run("latest", out).model(registry)
    config = compose_request(Request("compare", (), ("run=latest", f"out={out}")), registry)
    with pytest.raises(ConfigError, match="runs with your rights"):
        build_system(config, registry)
    assert track(Tracking(), out).failure is None
    assert not trace.exists()
    with pytest.raises(InputError, match="does not start"):  # the user names it: it is run
        spiral.system(system["path"])
    assert trace.exists()


def test_a_run_records_the_hash_of_its_plugins_and_no_path(question, out, tmp_path, plugin):
    registry = own_registry(tmp_path / "mine", plugin)
    folder = saved(question, out, registry, [registry.effect_from_label("own_spring")])
    digest = hashlib.sha256(plugin.encode()).hexdigest()
    data = json.loads((folder / FILE).read_text())
    assert data["local_plugins"] == {"effect/own_spring": digest}
    assert str(tmp_path / "mine") not in (folder / FILE).read_text()


def test_a_plugin_travels_with_the_model_where_it_is_the_one_recorded(
    question, out, tmp_path, plugin
):
    registry = own_registry(tmp_path / "mine", plugin)
    saved(question, out, registry, [registry.effect_from_label("own_spring")])
    assert track(Tracking(), out, registry=registry).failure is None
    (copy,) = [p for p in logged(out)[1] if p.name == "own.py"]
    assert copy.read_text() == plugin


@pytest.mark.hostile("saved runs")
@pytest.mark.parametrize("how", ["another text", "not loaded"])
def test_a_model_is_not_built_of_another_plugin_than_the_run_recorded(
    question, out, tmp_path, plugin, how
):
    registry = own_registry(tmp_path / "mine", plugin)
    folder = saved(question, out, registry, [registry.effect_from_label("own_spring")])
    now = None if how == "not loaded" else own_registry(tmp_path / "mine", plugin + "# changed\n")
    assert track(Tracking(), out, registry=now).failure is None
    run, paths = logged(out)
    assert not any(p.name in ("own.py", "MLmodel") for p in paths)
    assert "effect/own_spring" in run.data.tags["spiral.model"]
    assert (folder / "tracked.json").is_file()  # the rest is logged, and once


@pytest.mark.hostile("saved runs")
def test_a_run_that_claims_a_shipped_name_gets_no_local_plugin(question, out, tmp_path, plugin):
    """A local plugin of this command stands in for an effect only where the run recorded it."""
    registry = own_registry(tmp_path / "mine", plugin)
    folder = saved(question, out, registry, [registry.effect_from_label("own_spring")])
    changed(folder, local_plugins={})
    with pytest.raises(ConfigError, match="own_spring"):
        read_run(folder / FILE).local_files(registry)


@pytest.mark.hostile("saved runs")
def test_the_tracking_of_a_saved_run_is_not_obeyed(question, out, tmp_path):
    """``run=`` took the address of the tracking server, and the folder of runs, from the file."""
    folder = saved(question, out)
    data = json.loads((folder / FILE).read_text())
    evil = {**data["config"], "tracking": {"enabled": True, "uri": "http://evil.example:5000"},
            "out": str(tmp_path / "elsewhere"),
            "sweep": {"backend": "dask", "address": "tcp://evil.example:8786"}}  # fmt: skip
    changed(folder, config=evil)
    registry = load_registry(local=False)
    config = compose_request(Request("compare", overrides=("run=latest",)), registry)
    assert config["tracking"]["uri"] is None
    assert config["out"] == "runs"
    assert "evil.example" not in json.dumps(config, default=str)
    own = ("run=latest", "tracking.uri=sqlite:///mine.db", "out=runs")
    config = compose_request(Request("compare", overrides=own), registry)
    assert config["tracking"]["uri"] == "sqlite:///mine.db"


@pytest.mark.hostile("saved runs")
def test_runs_are_told_to_the_store_of_this_command_alone(question, out, monkeypatch):
    folder = saved(question, out)
    data = json.loads((folder / FILE).read_text())
    told = {"enabled": True, "uri": "http://127.0.0.1:9"}
    changed(folder, config={**data["config"], "tracking": told})
    found = track(Tracking(model=False), out)
    assert found.failure is None
    assert found.uri == f"sqlite:///{out / 'mlflow.db'}"


@pytest.mark.hostile("saved runs")
@pytest.mark.parametrize("name", [FILE, CURVES])
def test_a_link_out_of_a_runs_folder_is_not_followed(question, out, tmp_path, name):
    """A link in a downloaded folder would have another file logged as an artifact."""
    elsewhere = saved(question, tmp_path / "private")
    np.savez(elsewhere / CURVES, meta=np.frombuffer(b"{}", dtype=np.uint8))
    folder = saved(question, out)
    (folder / name).unlink(missing_ok=True)
    (folder / name).symlink_to(elsewhere / name)
    with pytest.raises(InputError, match="link out of its folder"):
        read_curves(folder) if name == CURVES else read_run(folder / FILE)


@pytest.mark.hostile("saved runs")
def test_a_run_is_called_by_its_folder_whatever_it_says(question, out):
    folder = saved(question, out)
    changed(folder, run_id="../../elsewhere")
    assert load_run("latest", out).run_id == folder.name
    odd = out / "a' or '1' = '1"
    shutil.copytree(folder, odd)
    assert run_ids(out) == [folder.name]


@pytest.mark.hostile("saved runs")
def test_a_run_that_cannot_be_read_keeps_no_other_from_being_told(question, out):
    broken = out / "20990101-000000-000aaaaaaaa"
    broken.mkdir()
    (broken / FILE).write_text("[" * 100_000)
    saved(question, out)
    assert track(Tracking(model=False), out).failure is None
    assert isinstance(logged(out)[0].info.run_id, str)


@pytest.mark.hostile("saved runs")
def test_a_compiled_file_beside_a_plugin_is_not_run(tmp_path, plugin, trace):
    """A ``__pycache__`` that came with a folder would run in place of the text that is named."""
    import importlib._bootstrap_external as files
    import importlib.util

    folder = tmp_path / "mine"
    folder.mkdir()
    harmless = folder / "own.py"
    harmless.write_text("# nothing\n")
    state = harmless.stat()
    code = compile(plugin, str(harmless), "exec")
    cached = importlib.util.cache_from_source(str(harmless))
    (folder / "__pycache__").mkdir()
    with open(cached, "wb") as target:
        target.write(files._code_to_timestamp_pyc(code, int(state.st_mtime), state.st_size))
    registry = load_registry(folder)
    assert not trace.exists()
    assert [f.sha256 for f in registry.local] == [hashlib.sha256(b"# nothing\n").hexdigest()]

"""Plugin files written before the modules moved keep working."""

import importlib
import subprocess
import sys

import pytest

from spiral.former_names import FORMER, present


@pytest.mark.parametrize("name", sorted(FORMER))
def test_a_former_name_is_the_same_module(name):
    former = importlib.import_module(f"spiral.{name}")
    now = importlib.import_module(f"spiral.{FORMER[name]}")
    assert former is now
    assert now.__spec__.name == f"spiral.{FORMER[name]}"


@pytest.mark.parametrize(
    "name",
    ["filtering.extended", "filtering.likelihood", "filtering.setup", "filtering.task",
     "reading.columns", "reading.files", "reading.preparation", "reading.readers"],
)  # fmt: skip
def test_modules_of_a_former_package_are_loaded_once(name):
    assert importlib.import_module(f"spiral.{name}") is importlib.import_module(
        present(f"spiral.{name}")
    )


def test_unknown_names_stay_unknown():
    with pytest.raises(ModuleNotFoundError, match=r"spiral\.nowhere"):
        importlib.import_module("spiral.nowhere")
    with pytest.raises(ModuleNotFoundError, match=r"filtering\.nowhere"):
        importlib.import_module("spiral.filtering.nowhere")
    assert present("numpy.effect") is None


def test_import_is_light_and_every_public_name_is_there():
    code = (
        "import sys, spiral; heavy = {'numpy', 'scipy', 'torch', 'mlflow', 'pandas', 'sympy'};"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules);"
        "[getattr(spiral, n) for n in spiral.__all__]; print(len(spiral.__all__));"
        "assert 'torch' not in sys.modules and 'mlflow' not in sys.modules"
    )
    made = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 20 <= int(made.stdout) <= 30

"""For all tests: commands wait for what they tell MLflow; long files are begun first."""

from pathlib import Path

import pytest

from spiral.io.tracking.background import WAIT_VARIABLE

# A quarter of a minute or more each, longest first: with two workers none of them is begun last.
LONG = (
    "browser/test_story.py", "browser/test_files.py", "theory/test_discover.py",
    "browser/test_data_setup.py", "contract/test_how_to.py", "contract/test_plugins.py",
    "experiments/test_hidden_effects.py", "contract/test_tracking.py", "theory/test_memory.py",
    "theory/test_inputs.py", "docs/test_notebooks.py", "experiments/test_zoo.py",
    "contract/test_third_party.py", "contract/test_unfinished.py", "browser/test_steps.py",
    "theory/test_sensors.py", "theory/test_unknown.py",
    "theory/test_look_alikes.py", "theory/test_calibrate.py", "contract/test_new_and_check.py",
    "contract/test_dask.py", "theory/test_published.py", "experiments/test_configs.py",
    "theory/test_compile.py", "theory/test_laws.py", "browser/test_hostile_files.py",
    "browser/test_studies.py", "contract/test_sweeps.py",
)  # fmt: skip


def pytest_collection_modifyitems(items):
    """Long files first, each with its tests in their own order; before all those of safety.

    They measure memory. A process that a worker starts is told to have taken at least as much as
    that worker holds by then, which the tests before have left.
    """
    here = Path(__file__).parent
    rank = {here / name: number for number, name in enumerate(LONG)}
    rank |= dict.fromkeys((here / "safety").glob("test_*.py"), -1)
    items.sort(key=lambda item: rank.get(item.path, len(LONG)))


@pytest.fixture(autouse=True, scope="session")
def nothing_in_the_background():
    """For commands in processes of their own, too; a test of the background says otherwise."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(WAIT_VARIABLE, "1")
        yield

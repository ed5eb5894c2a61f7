"""Every test waits for what its commands tell MLflow, except those that are about not waiting."""

import pytest

from spiral.io.tracking.background import WAIT_VARIABLE


@pytest.fixture(autouse=True, scope="session")
def nothing_in_the_background():
    """For commands in processes of their own, too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(WAIT_VARIABLE, "1")
        yield

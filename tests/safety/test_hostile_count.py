"""How many hostile inputs there are: run this folder to see how long and how much each took."""

from pathlib import Path

import pytest

FEWEST = 60
KINDS = {"files", "saved runs", "study folders", "formulas", "overrides", "http", "websocket"}


def test_sixty_hostile_inputs_of_every_kind_are_tried(collected):
    kinds, files = collected
    if {p.name for p in Path(__file__).parent.glob("test_*.py")} - files:
        pytest.skip("counts where the whole folder is collected")
    assert set(kinds) == KINDS
    assert kinds.total() >= FEWEST

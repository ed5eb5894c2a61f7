"""How many hostile inputs there are: run this folder to see how long and how much each took."""

from collections import Counter
from pathlib import Path

import pytest

FEWEST = 60
KINDS = {"files", "saved runs", "study folders", "formulas", "overrides", "http", "websocket"}


def test_sixty_hostile_inputs_of_every_kind_are_tried(request):
    here = Path(__file__).parent
    if {p.name for p in here.glob("test_*.py")} - {i.path.name for i in request.session.items}:
        pytest.skip("counts where the whole folder runs")
    marks = [m for i in request.session.items for m in i.iter_markers("hostile")]
    kinds = Counter(mark.args[0] for mark in marks)
    assert set(kinds) == KINDS
    assert kinds.total() >= FEWEST

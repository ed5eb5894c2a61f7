"""Which winners of a race are asked: none that came to a maximum that was rejected."""

from types import SimpleNamespace

import numpy as np

from spiral.inference.strategies.likelihood.accepted import NOTHING_TRIED, RaceOutcome
from spiral.inference.strategies.likelihood.admission import _unasked


def winners(*pairs):
    """Winners of a race by label and worth, each with no rivals behind it."""
    return iter([(SimpleNamespace(label=label, worth=worth), []) for label, worth in pairs])


def asked(race, before=NOTHING_TRIED):
    """The winners that are asked, why others are not, and what each is worth."""
    rejected, worths = {}, {}
    chosen = [(r.label, r.worth) for r, _ in _unasked(race, before, rejected, worths)]
    return chosen, rejected, worths


def test_a_second_start_of_a_winner_is_asked_only_if_it_leads_further():
    chosen, _, worths = asked(winners(("lag", 90.0), ("lag", 89.5), ("stop", 7.0), ("lag", 95.0)))
    assert chosen == [("lag", 90.0), ("stop", 7.0), ("lag", 95.0)]
    assert worths == {"lag": 95.0, "stop": 7.0}


def test_what_an_earlier_race_rejected_there_takes_no_place():
    before = RaceOutcome(None, {"lag": "it grows"}, worths={"lag": 90.0})
    chosen, rejected, worths = asked(winners(("lag", 90.5), ("lag", 70.0), ("stop", 7.0)), before)
    assert chosen == [("stop", 7.0)]
    assert rejected == {"lag": "it grows"}
    assert worths == {"lag": 90.5, "stop": 7.0}


def test_what_the_whole_records_refused_is_never_asked_again():
    before = RaceOutcome(None, {"lag": "too small"}, refused=("lag",)).refused_on_whole()
    assert before.worths == {"lag": np.inf}
    assert (
        asked(
            winners(
                ("lag", 1e6),
            ),
            before,
        )[0]
        == []
    )

"""Verdicts point by point."""

from spiral.types.formatting import capitalised, duration, extent, sentences


def test_sentences_are_points_and_lists_are_listed():
    told = sentences(
        "Missing was rub at disk: test error 6.5 % -> 2.1 % (noise floor 1.9 %). More is missing: "
        "what is left is not white; system.k is zero within its error. What is left is small."
    )
    assert told == [
        ("Missing was rub at disk: test error 6.5 % -> 2.1 % (noise floor 1.9 %).", ()),
        ("More is missing:", ("what is left is not white", "system.k is zero within its error")),
        ("What is left is small.", ()),
    ]


def test_clauses_of_their_own_are_points_and_what_goes_on_stays():
    told = sentences(
        "Sensor x: 2 readings are missing; they are left out; a random force acts on x: 3 % of "
        "all; system.k ends far off."
    )
    assert [point for point, _ in told] == [
        "Sensor x: 2 readings are missing; they are left out.",
        "A random force acts on x: 3 % of all.",
        "system.k ends far off.",
    ]


def test_what_stands_in_brackets_stays_together():
    told = "Air is held (record.hold=zero_order declares it; 3 samples of delay look the same)."
    assert sentences(told) == [(told, ())]


def test_no_text_has_no_points():
    assert sentences(" ") == []


def test_times_are_told_in_a_unit_in_which_they_are_small():
    told = [duration(s) for s in (0.0123, 450, 5700, 23_000, 340_000, 2.3e8)]
    assert told == ["0.012 s", "450 s", "95 min", "6.4 h", "3.9 d", "2662 d"]


def test_slow_records_tell_how_often_they_are_read():
    assert extent(6000, 2000.0) == "6000 samples, 3 s, 2000 Hz"
    assert extent(720, 1 / 3600) == "720 samples, 30 d, one every 60 min"


def test_names_keep_their_letters_at_the_beginning_of_a_sentence():
    assert capitalised("noise of a sensor is large") == "Noise of a sensor is large"
    assert capitalised("system.k is zero") == "system.k is zero"
    told = sentences("What is left is white noise. system.k ends far off. So it is.")
    assert len(told) == 3

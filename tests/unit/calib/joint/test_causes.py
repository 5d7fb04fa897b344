"""What a person did to a bench is named first, with its place, size and remedy; right statements are not accused."""

import pytest
from slow_cases import first_quick, slow

from calib.model.cause import Cause, cause_sentence
from tests.benchmarks.worlds.mistakes import MISTAKES, mistaken


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("camera knocked by 0.3 degrees", "The camera turned in its mount between the poses"),
        slow("pitch 4.2 instead of 4.0139 mm", "the pitch of the target is probably 0.95"),
        # These two are told in test_readings.py too, of benches that take less time.
        slow("sign of pan", "The sign of pan or of tilt is wrong in the station file"),
        slow("scale of pan 5 % off", "The pan axis turns 0.95"),
    ],
)
def test_the_cause_is_named_first_and_nothing_right_is_accused(name, words):
    line = mistaken(name, 1)
    assert line["causes"] == list(MISTAKES[name].named)
    assert words in line["told"][0]
    assert not [
        sentence
        for sentence in line["told"]
        if "The statement" in sentence or "contradict the stars" in sentence
    ]


@pytest.mark.parametrize("name", first_quick(["healthy", "camera upside down"]))
def test_nobody_is_blamed_on_a_bench_that_is_right(name):
    assert mistaken(name, 2)["told"] == []


def test_a_cause_is_the_same_after_it_was_written_and_read():
    cause = Cause(
        "axis slipped", 40.0, -0.3, 0.01, "degrees", None, "pan", "left", "right", ("x",), ("y", "z")
    )
    assert Cause.from_dict(cause.to_dict()) == cause


def test_what_the_data_cannot_tell_apart_is_told_together():
    cause = Cause("axis slipped", 40.0, -0.3, 0.01, "degrees", axis="pan", before="left", pose="right")
    alone = cause_sentence(cause)
    both = cause_sentence(Cause(**{**cause.to_dict(), "beside": ("camera turned in its mount",)}))
    assert "0.300 ± 0.010 degrees (k = 2) more" in alone
    assert "Check" in alone
    assert "camera turned in its mount" in both
    assert "Check" not in both
    assert "To tell them apart" in both

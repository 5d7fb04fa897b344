"""Durations as people say them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.wording.numbers import duration


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0, "0 ms"), (0.9996, "1.0 s"), (9.94, "9.9 s"), (9.96, "10 s"), (59.4, "59 s"), (59.6, "1 min 0 s"), (3599, "59 min 59 s"), (3600, "1 h 0 min")],
)  # fmt: skip
def test_a_duration_is_said_as_people_say_it(seconds, text):
    assert duration(seconds) == text


@given(st.floats(0, 1e7))
def test_a_duration_is_said_without_sixty_seconds_or_minutes(seconds):
    text = duration(seconds)
    assert "60 s" not in text
    assert "60 min" not in text

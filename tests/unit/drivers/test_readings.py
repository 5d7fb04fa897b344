"""When a value read over a line is believed."""

import pytest

from drivers.errors import ReplyGarbled
from drivers.retry import Reading, read_position_until_agreed, read_until_agreed


def position(readings: list[tuple[float, float, bool]]) -> float:
    told = iter(readings)
    return read_position_until_agreed(
        lambda: Reading(*next(told)),
        tolerance_deg=0.01,
        speed_deg_s=10.0,
        what="pan's position",
        where="port",
    )


def test_two_equal_readings_are_believed() -> None:
    values = iter([1, 2, 1, 1, 9])
    assert read_until_agreed(lambda: next(values), what="it", where="port") == 1


def test_readings_that_never_agree_are_refused() -> None:
    values = iter(range(10))
    with pytest.raises(ReplyGarbled, match="port: 5 readings of it do not agree"):
        read_until_agreed(lambda: next(values), what="it", where="port")


def test_a_standing_axis_is_believed_at_the_second_equal_reading() -> None:
    assert position([(0.0, 5.0, False), (0.1, 5.0, False)]) == 5.0


def test_a_reading_that_is_off_by_one_digit_is_outvoted() -> None:
    assert position([(0.0, 5.0, False), (0.1, 5.001, False), (0.2, 5.0, False)]) == 5.0
    assert position([(0.0, 5.0, False), (0.1, 85.0, False), (0.2, 5.0, False), (0.3, 5.0, False)]) == 5.0


def test_an_axis_that_trembles_is_where_its_middle_is() -> None:
    assert position([(0.0, 5.002, False), (0.1, 5.0, False), (0.2, 5.001, False)]) == 5.001


def test_a_moving_axis_may_have_come_as_far_as_its_speed_allows() -> None:
    assert position([(0.0, 5.0, True), (0.1, 6.0, True)]) == 6.0


def test_a_moving_axis_does_not_jump() -> None:
    with pytest.raises(ReplyGarbled):
        position([(0.1 * n, 3.0 * n, True) for n in range(5)])

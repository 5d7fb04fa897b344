"""Moves: time, limits, readings."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.agreed_reading import Reading, read_position_until_agreed, read_until_agreed
from drivers.errors import MoveFailed, MoveTimeout, OutsideLimits, ReplyGarbled
from drivers.stage import AxisLimits
from drivers.stage.esp import EspAxis
from drivers.stage.motion import (
    MoveWatch,
    check_targets,
    deadline_s,
    longest_homing_s,
    longest_move_s,
    travel_time_s,
)

PAN = AxisLimits(-15.0, 15.0, speed_deg_s=10.0, acceleration_deg_s2=20.0)

TILT = AxisLimits(-10.0, 10.0, speed_deg_s=1.0, acceleration_deg_s2=20.0)

LIMITS = {"pan": PAN, "tilt": TILT}


def watch(target_deg: float | None = 5.0) -> MoveWatch:
    axis = EspAxis(name="pan", number=1, limits=PAN, tolerance_deg=0.001)
    return MoveWatch(axis, target_deg, now_s=0.0, allowed_s=4.0)


@given(st.floats(1e-3, 1e3), st.floats(0.1, 100.0), st.floats(0.1, 1000.0))
def test_travel_time_is_that_of_the_speed_profile_integrated(distance, speed, acceleration) -> None:
    total = travel_time_s(distance, speed, acceleration)
    ramp = min(total / 2.0, speed / acceleration)
    assert acceleration * ramp * (total - ramp) == pytest.approx(distance, rel=1e-9)


def test_the_slowest_axis_decides_the_time_of_a_move() -> None:
    slowest_s = longest_move_s(LIMITS, {"pan": 0.0, "tilt": 0.0}, {"pan": 10.0, "tilt": 5.0})
    assert slowest_s == pytest.approx(5.05)
    assert longest_move_s(LIMITS, {"pan": 0.0}, {}) == 0.0


def test_the_deadline_grows_with_the_distance() -> None:
    assert deadline_s(PAN, 0.0, 10.0) == pytest.approx(1.5 + 2 * 0.5 + 3.0)


def test_all_axes_at_fault_are_named_at_once() -> None:
    with pytest.raises(OutsideLimits) as caught:
        check_targets(LIMITS, {"pan": 15.1, "tilt": -11.0, "yaw": 0.0}, "port")
    assert "pan 15.1 deg" in str(caught.value)
    assert "tilt -11 deg" in str(caught.value)
    assert "no axis 'yaw'" in str(caught.value)
    check_targets(LIMITS, {"pan": 15.0, "tilt": -10.0}, "port")


def test_not_a_number_is_outside_all_limits() -> None:
    with pytest.raises(OutsideLimits):
        check_targets(LIMITS, {"pan": float("nan")}, "port")


@pytest.mark.parametrize(
    ("target_deg", "readings"),
    [
        (5.0, [(0.1, 2.0, True), (0.2, 5.0, False), (0.3, 5.0005, False)]),
        (5.0, [(0.1, 2.0, True), (60.2, 5.0, False), (60.3, 5.0005, False)]),
        (15.0, [(1.0, 15.0, False), (1.1, 5.0, False), (1.2, 15.0, False)]),
        (None, [(0.1, -3.0, True), (0.2, 0.0, False), (0.3, 0.0, False)]),
    ],
    ids=["awake", "the computer slept", "a reading lost a digit", "a search"],
)
def test_a_move_has_arrived_after_two_idle_reads_at_its_target(target_deg, readings) -> None:
    move = watch(target_deg)
    arrived = [move.update(now_s, angle_deg, busy=busy) for now_s, angle_deg, busy in readings]
    assert arrived == [False, False, True]


NEVER_AT_ONE_PLACE = [(1.0 + step, 5.0 + step, False) for step in range(8)]
CREEPING = [(0.1 * tick, 0.001 * tick, True) for tick in range(41)]


@pytest.mark.parametrize(
    ("target_deg", "readings", "error", "fact"),
    [
        (5.0, [(0.1, 4.9, False), (0.2, 4.9, False)], MoveFailed, r"pan: .* 4\.9000 .* -0\.1000 .* 5\.0000"),
        (15.0, [*NEVER_AT_ONE_PLACE, (9.0, 1.0, False)], MoveFailed, r"1\.0000 deg"),
        (5.0, [(0.1, 2.0, True), (1.6, 2.0, True), (1.7, 2.0, True)], MoveFailed, r"1\.5 s, at 2\.0000 deg"),
        (5.0, [*CREEPING, (4.1, 0.1, True)], MoveTimeout, r"4\.0 s"),
        (None, [(3.9, math.nan, True), (4.1, math.nan, True)], MoveTimeout, r"reference .* 4\.0 s"),
    ],
    ids=["stops short", "never agrees", "without progress", "creeps for ever", "a search"],
)
def test_a_move_that_does_not_arrive_has_failed_at_its_last_reading(target_deg, readings, error, fact):
    move = watch(target_deg)
    *before, (now_s, angle_deg, busy) = readings
    assert not any(move.update(*reading[:2], busy=reading[2]) for reading in before)
    with pytest.raises(error, match=fact) as caught:
        move.update(now_s, angle_deg, busy=busy)
    assert ("reference sensor" in caught.value.remedy) == (target_deg is None)


def test_one_idle_read_in_mid_move_decides_nothing() -> None:
    move = watch()
    for tick, busy in enumerate([True, False, True, False, True]):
        assert not move.update(0.1 * tick, float(tick), busy=busy)


def test_a_search_may_turn_twice_at_the_speed_of_the_controller_and_that_speed_is_not_the_station_s() -> None:
    pan, tilt = (EspAxis(name=name, number=1, limits=limits) for name, limits in LIMITS.items())
    assert longest_homing_s(pan, 2.0) == longest_homing_s(tilt, 2.0) == pytest.approx(30.0 + 360.0)
    assert longest_homing_s(pan, None) == 180.0
    assert longest_homing_s(tilt, None) == pytest.approx(30.0 + 720.0)
    with pytest.raises(MoveFailed, match="reference search is 0"):
        longest_homing_s(pan, 0.0)


# ---------------------------------------------------------------- readings


def position(readings: list[tuple[float, float, bool]]) -> float:
    remaining = iter(readings)
    return read_position_until_agreed(
        lambda: Reading(*next(remaining)),
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
    with pytest.raises(ReplyGarbled, match="port: 5 readings"):
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

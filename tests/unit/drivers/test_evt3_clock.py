"""The EVT3 decoder's clock: wraps, steps back, gaps, and what is covered."""

import numpy as np
import pytest

from drivers.camera.evt3 import Evt3Decoder
from drivers.errors import RecordingCorrupt
from tests.unit.drivers.evt3_words import HEIGHT, LOOP_US, WIDTH, decode, event, high, low, row


def test_a_repeated_time_high_changes_nothing():
    assert decode(high(1), low(7), high(1), row(0), event(0))[0] == [(4103, 0, 0, 0)]


def test_a_new_time_high_starts_at_its_first_microsecond():
    assert decode(high(1), low(7), high(2), row(0), event(0))[0] == [(8192, 0, 0, 0)]


def test_the_clock_wraps_after_24_bits_and_times_go_on():
    found, _, statistics = decode(high(0xFFF), low(0xFFF), row(0), event(0), high(0), low(3), event(1))
    assert [t for t, *_ in found] == [LOOP_US - 1, LOOP_US + 3]
    assert statistics.gap_count == 0


def test_every_further_wrap_counts():
    words = [word for k in range(5) for word in (high(0xFFF), low(1), high(0), low(2))]
    assert decode(*words)[2].last_t_us == 5 * LOOP_US + 2


def test_time_low_stepping_back_by_some_microseconds_is_no_wrap():
    found, _, _ = decode(high(1), low(20), row(0), event(0), low(9), event(1))
    assert [t for t, *_ in found] == [4116, 4105]


@pytest.mark.parametrize(("back", "fine"), [(64, True), (65, False)])
def test_how_far_a_clock_may_step_back(back, fine):
    words = [high(1), low(100), low(100 - back)]
    if fine:
        assert decode(*words)[2].last_t_us == 4096 + 100 - back
    else:
        with pytest.raises(RecordingCorrupt):
            decode(*words)


@pytest.mark.parametrize(("new", "wraps"), [(1000, True), (1001, False)])
def test_a_time_high_that_is_half_a_turn_lower_has_wrapped(new, wraps):
    words = [high(1000 + 2048), low(0), high(new)]
    if wraps:
        assert decode(*words)[2].last_t_us == LOOP_US + (1000 << 12)
    else:
        with pytest.raises(RecordingCorrupt):
            decode(*words)


def test_a_stream_without_a_whole_time_has_no_duration():
    assert decode()[2].duration_s == 0.0
    assert decode(high(5))[2].duration_s == 0.0


def test_a_stream_that_begins_at_zero_covers_its_time():
    assert decode(high(0), low(0), low(5), low(9))[2].first_t_us == 0


def test_time_low_stepping_back_far_means_missing_words():
    with pytest.raises(RecordingCorrupt, match="steps back from 8000 us: its lower part reads 5") as caught:
        decode(high(1), low(8000 - 4096), low(5))
    assert caught.value.offset == 4


def test_time_high_stepping_back_is_refused():
    with pytest.raises(RecordingCorrupt, match="upper part reads 9") as caught:
        decode(high(10), low(0), high(9))
    assert caught.value.offset == 4


def test_time_high_leaping_forward_is_a_gap():
    statistics = decode(high(10), low(100), high(12), low(0))[2]
    assert statistics.gaps == ((10 * 4096 + 100, 12 * 4096),)
    assert statistics.loss_messages() == ("Words are missing from 41060 to 49152 us of the sensor's clock.",)


def test_gaps_beyond_the_kept_ones_are_counted():
    words = [word for k in range(100) for word in (high(2 * k), low(0))]
    statistics = decode(*words)[2]
    assert (statistics.gap_count, len(statistics.gaps)) == (99, 64)
    assert statistics.loss_messages()[-1] == "35 more gaps follow."


def test_a_leap_over_the_wrap_is_a_gap_and_one_turn():
    statistics = decode(high(0xFFE), low(0), high(1), low(5))[2]
    assert statistics.gap_count == 1
    assert statistics.last_t_us == LOOP_US + 4096 + 5


def test_a_time_low_before_the_first_time_high_is_no_time():
    assert decode(low(5), row(0), event(0))[2].first_t_us == -1


def test_events_between_the_first_time_high_and_its_time_low_are_at_its_start():
    found, _, statistics = decode(row(3), high(2), event(7, 1), low(5), event(8))
    assert found == [(8192, 7, 3, 1), (8197, 8, 3, 0)]
    assert statistics.first_t_us == 8197


def test_the_clock_covered_counts_from_the_first_time_word():
    decoder = Evt3Decoder(WIDTH, HEIGHT)
    assert decoder.covered_us == 0
    decoder.tally(np.array([high(5), low(10)], np.uint16))
    assert decoder.covered_us == 0
    decoder.tally(np.array([high(6), low(20)], np.uint16))
    assert decoder.covered_us == 4096 + 10
    assert decoder.statistics().duration_s == pytest.approx(4106e-6)

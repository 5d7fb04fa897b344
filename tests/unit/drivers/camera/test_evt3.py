"""EVT3: words, clock, losses."""

import numpy as np
import pytest

from drivers.camera.event_arrays import empty_events
from drivers.camera.evt3 import Evt3Decoder
from drivers.errors import RecordingCorrupt
from tests.unit.drivers.camera.evt3_words import (
    HEIGHT,
    LOOP_US,
    WIDTH,
    base,
    decode,
    event,
    high,
    low,
    others,
    row,
    rows,
    trigger,
    vector8,
    vector12,
)


@pytest.mark.parametrize(
    ("words", "events"),
    [
        ([row(5) | 0x800, event(3)], [(0, 3, 5, 0)]),
        ([0x1000 | 5, event(3), row(6), event(4)], [(0, 4, 6, 0)]),
        ([event(3), row(0), vector12(7)], []),
        ([row(0), base(WIDTH - 2), vector12(0b11)], [(0, WIDTH - 2, 0, 0), (0, WIDTH - 1, 0, 0)]),
    ],
    ids=["slave bit", "row of another kind", "before the first row or base", "vector up to the edge"],
)
def test_an_event_has_the_place_that_the_words_before_it_say(words, events):
    assert decode(high(0), low(0), *words)[0] == events


def test_events_before_the_first_time_are_dropped():
    events, edges, _ = decode(row(5), event(3), base(0), vector12(7), trigger(1), high(1), low(2), event(4))
    assert events == [(4098, 4, 5, 0)]
    assert edges == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((row(0), event(1), row(HEIGHT)), "Row 720 .* 1280 x 720"),
        ((row(0), event(1), event(WIDTH)), "column 1280 .* 1280 x 720"),
        ((row(HEIGHT),), "Row 720 .* 1280 x 720"),
        ((row(0), event(WIDTH)), "column 1280 .* 1280 x 720"),
        ((row(0), base(WIDTH - 4), vector12(0b10000)), "vector .* column 1276 "),
        ((row(0), base(WIDTH - 4), vector8(0b10000)), "vector .* column 1276 "),
        ((row(0), base(2047), vector12(1)), "vector .* column 2047 "),
        ((row(0), base(WIDTH - 20), vector12(1), vector12(1 << 8)), "vector .* column 1272 "),
        ((0x9000,), "0x9000"),
        ((0xB123,), "0xB123"),
        ((0xCFFF,), "0xCFFF"),
    ],
)
def test_malformed_words_are_refused_at_their_byte(words, message):
    decoder = Evt3Decoder(WIDTH, HEIGHT, first_byte=100, where="x.raw")
    with pytest.raises(RecordingCorrupt, match=message) as caught:
        decode(high(0), low(0), *words, row(1), decoder=decoder)
    assert caught.value.offset == 100 + 2 * (2 + len(words) - 1)
    assert str(caught.value).startswith("x.raw: ")


def test_padding_is_skipped():
    """Some cameras fill their packets with 0x9999."""
    words = [high(0), 0x9999, low(5), 0x9999, row(1), event(7), 0x9999, 0x9999, event(8)]
    assert decode(*words)[0] == [(5, 7, 1, 0), (5, 8, 1, 0)]


def test_words_of_other_types_are_counted_and_left_out_where_that_is_asked_for():
    decoder = Evt3Decoder(WIDTH, HEIGHT, skip_unknown=True)
    words = [high(0), low(5), row(1), 0xB123, event(7), 0x9999, 0xCFFF, event(8), 0x9000]
    assert decode(*words, decoder=decoder)[0] == [(5, 7, 1, 0), (5, 8, 1, 0)]
    assert decoder.statistics().unknown_words == 3


def test_events_before_a_malformed_word_are_handed_out():
    decoder = Evt3Decoder(WIDTH, HEIGHT)
    pieces = decoder.decode([np.array([high(0), low(0), row(0), event(7), 0x9000], np.uint16)])
    assert rows(next(pieces)[0]) == [(0, 7, 0, 0)]
    with pytest.raises(RecordingCorrupt):
        next(pieces)


@pytest.mark.parametrize("missing", ["row", "base"])
def test_events_without_a_place_count_nowhere(missing):
    image = np.zeros((2, HEIGHT, WIDTH), np.uint16)
    decoder = Evt3Decoder(WIDTH, HEIGHT)
    words = [high(0), low(0), base(5) if missing == "row" else row(5), vector12(7), event(9) | 0x800]
    decoder.count(np.array(words, np.uint16), image)
    assert image.sum() == (0 if missing == "row" else 1)
    assert decoder.statistics().events == image.sum()


def test_an_image_of_another_size_is_refused():
    with pytest.raises(ValueError, match="sensor"):
        Evt3Decoder(WIDTH, HEIGHT).count(np.array([high(0)], np.uint16), np.zeros((2, 10, 10), np.uint16))


def test_arrays_without_room_are_refused():
    words = np.array([high(0), low(0), row(0), *[event(k) for k in range(40)]], np.uint16)
    with pytest.raises(ValueError, match="no room"):
        Evt3Decoder(WIDTH, HEIGHT).decode_into(words, empty_events(39), 0)


def test_decoding_into_arrays_touches_nothing_beyond_the_room_it_asks_for():
    words = np.array([high(0), low(0), row(0), *[event(k) for k in range(300)]], np.uint16)
    events = empty_events(352)
    events.x[:] = 7
    end, _ = Evt3Decoder(WIDTH, HEIGHT).decode_into(words, events.part(10, 342), 0)
    assert end == 300
    assert events.x[:310].tolist() == [7] * 10 + list(range(300))
    assert events.x[342:].tolist() == [7] * 10


def test_decoding_into_arrays_refuses_a_malformed_first_word():
    with pytest.raises(RecordingCorrupt) as caught:
        Evt3Decoder(WIDTH, HEIGHT).decode_into(np.array([0x9000], np.uint16), empty_events(50), 0)
    assert caught.value.offset == 0


# ---------------------------------------------------------------- the clock


def test_the_clock_wraps_after_24_bits_and_times_go_on():
    events, _, statistics = decode(high(0xFFF), low(0xFFF), row(0), event(0), high(0), low(3), event(1))
    assert [t for t, *_ in events] == [LOOP_US - 1, LOOP_US + 3]
    assert statistics.gap_count == 0


@pytest.mark.parametrize(
    ("words", "last_t_us"),
    [([high(1), low(100), low(36)], 4096 + 36), ([high(3048), low(0), high(1000)], LOOP_US + (1000 << 12))],
    ids=["64 us", "half a turn"],
)
def test_a_clock_may_step_back_a_little_or_wrap(words, last_t_us):
    assert decode(*words)[2].last_t_us == last_t_us


@pytest.mark.parametrize(
    ("words", "fact"),
    [
        ([high(1), low(100), low(35)], "4196 us.* 35"),
        ([high(1), low(8000 - 4096), low(5)], "8000 us.* 5"),
        ([high(1001 + 2047), low(0), high(1001)], "1001"),
        ([high(10), low(0), high(9)], "9"),
    ],
    ids=["65 us", "far", "less than half a turn", "one high word"],
)
def test_a_clock_that_steps_back_further_means_missing_words(words, fact):
    with pytest.raises(RecordingCorrupt, match=fact) as caught:
        decode(*words)
    assert caught.value.offset == 4


@pytest.mark.parametrize(
    ("words", "first_t_us"), [([high(0), low(0), low(5)], 0), ([low(5), row(0), event(0)], -1)]
)
def test_a_stream_begins_with_its_first_whole_time(words, first_t_us):
    assert decode(*words)[2].first_t_us == first_t_us


def test_a_stream_without_a_whole_time_has_no_duration():
    assert decode()[2].duration_s == 0.0
    assert decode(high(5))[2].duration_s == 0.0


def test_time_high_leaping_forward_is_a_gap():
    statistics = decode(high(10), low(100), high(12), low(0))[2]
    assert statistics.gaps == ((10 * 4096 + 100, 12 * 4096),)
    (told,) = statistics.loss_messages()
    assert "41060 to 49152 us" in told


def test_gaps_beyond_the_kept_ones_are_counted():
    words = [word for k in range(100) for word in (high(2 * k), low(0))]
    statistics = decode(*words)[2]
    assert (statistics.gap_count, len(statistics.gaps)) == (99, 64)
    assert statistics.loss_messages()[-1] == "35 more gaps follow."


def test_a_leap_over_the_wrap_is_a_gap_and_one_turn():
    statistics = decode(high(0xFFE), low(0), high(1), low(5))[2]
    assert statistics.gap_count == 1
    assert statistics.last_t_us == LOOP_US + 4096 + 5


def test_events_between_the_first_time_high_and_its_time_low_are_at_its_start():
    events, _, statistics = decode(row(3), high(2), event(7, 1), low(5), event(8))
    assert events == [(8192, 7, 3, 1), (8197, 8, 3, 0)]
    assert statistics.first_t_us == 8197


def test_the_clock_covered_counts_from_the_first_time_word():
    decoder = Evt3Decoder(WIDTH, HEIGHT)
    assert decoder.covered_us == 0
    decoder.tally(np.array([high(5), low(10)], np.uint16))
    assert decoder.covered_us == 0
    decoder.tally(np.array([high(6), low(20)], np.uint16))
    assert decoder.covered_us == 4096 + 10
    assert decoder.statistics().duration_s == pytest.approx(4106e-6)


# ---------------------------------------------------------------- losses


def reported(*windows, parts=3):
    """A stream of windows of (events, events that the sensor says it sent), each with its report."""
    words = [high(0), low(0), row(0), *others(0x016, 123)]
    for events, counted in windows:
        words += [event(k) for k in range(events)]
        words += [*others(0x014, counted + 5), *others(0x016, counted, parts=parts)]
    return decode(*words)[2]


@pytest.mark.parametrize("parts", [2, 3])
def test_a_stream_that_has_what_the_sensor_counted_has_lost_nothing(parts):
    statistics = reported((3, 3), (0, 0), (7, 7), parts=parts)
    assert (statistics.lost_events, statistics.mismatched_windows, statistics.loss_messages()) == (0, 0, ())


def test_events_that_the_sensor_counted_and_that_did_not_arrive_are_lost():
    statistics = reported((2, 6), (3, 3), (7, 7), (0, 1))
    assert (statistics.lost_events, statistics.mismatched_windows) == (5, 2)
    assert "5 events are missing" in statistics.loss_messages()[0]


@pytest.mark.parametrize(
    "stray", [[0xE016, 0x7003], [0xF005], [0x7001], [0xE016, 0xF000, 0xF000, 0xF001, 0x7001]]
)
def test_parts_of_a_payload_out_of_their_order_count_nowhere(stray):
    assert decode(*others(0x016, 3), *stray)[2].rate_controller_out == 3


def test_a_report_that_did_not_arrive_leaves_an_odd_window():
    statistics = reported((3, 3), (9, 4))
    assert (statistics.lost_events, statistics.mismatched_windows) == (0, 1)


def test_payloads_of_other_subtypes_count_nowhere():
    statistics = decode(*others(0x016, 3), *others(0x0FF, 77), 0xD000, 0xF123, 0xF456)[2]
    assert statistics.rate_controller_out == 3


def test_a_sensor_that_does_not_report_its_rate_controller_is_not_taken_for_zero():
    assert decode(high(0), low(0))[2].rate_controller_in is None

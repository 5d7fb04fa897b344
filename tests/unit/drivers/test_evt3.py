"""The EVT3 decoder word by word: events, vectors, triggers, images, and what it refuses."""

import numpy as np
import pytest

from drivers.camera.event_arrays import empty_events
from drivers.camera.evt3 import Evt3Decoder
from drivers.errors import RecordingCorrupt
from tests.unit.drivers.evt3_words import (
    HEIGHT,
    WIDTH,
    base,
    decode,
    event,
    high,
    low,
    row,
    rows,
    trigger,
    vector8,
    vector12,
)


def test_one_event_has_the_time_row_column_and_polarity_of_its_words():
    assert decode(high(1), low(2), row(5), event(3, 1))[0] == [(4098, 3, 5, 1)]


def test_arrays_have_the_types_they_promise():
    [(events, triggers)] = Evt3Decoder(WIDTH, HEIGHT).decode(np.array([high(1), low(2)], np.uint16))
    assert [field.dtype for field in events] == [np.int64, np.uint16, np.uint16, np.uint8]
    assert [field.dtype for field in triggers] == [np.int64, np.uint8, np.uint8]


def test_vectors_give_one_event_a_bit_and_move_their_base_on():
    found, _, _ = decode(
        high(0), low(9), row(7), base(100, 1), vector12(0b1000_0000_0001), vector12(0b10), vector8(0xFF)
    )
    assert [x for _, x, _, _ in found] == [100, 111, 113, *range(124, 132)]
    assert {(t, y, p) for t, _, y, p in found} == {(9, 7, 1)}


def test_a_vector_of_eight_takes_eight_bits_only():
    assert decode(high(0), low(0), row(0), base(0), vector8(0) | 0xF00)[0] == []


def test_vectors_reach_the_last_column():
    found, _, _ = decode(high(0), low(0), row(0), base(WIDTH - 12), vector12(0xFFF))
    assert found[-1][1] == WIDTH - 1


def test_a_base_near_the_edge_is_fine_as_long_as_no_bit_lies_beyond_it():
    assert len(decode(high(0), low(0), row(0), base(WIDTH - 4), vector12(0b1111))[0]) == 4


def test_slave_bit_of_a_row_is_no_part_of_the_row():
    assert decode(high(0), low(0), row(5) | 0x800, event(3))[0] == [(0, 3, 5, 0)]


def test_triggers_have_time_edge_and_channel():
    assert decode(high(1), low(2), trigger(1), low(5), trigger(0, 3))[1] == [(4098, 1, 0), (4101, 0, 3)]


def test_more_triggers_than_the_buffer_holds_all_arrive():
    words = [high(0), low(0), *[trigger(k % 2) for k in range(10_000)]]
    _, edges, statistics = decode(*words)
    assert [value for _, value, _ in edges] == [k % 2 for k in range(10_000)]
    assert statistics.triggers == 10_000


def test_events_before_the_first_time_are_dropped():
    found, edges, _ = decode(row(5), event(3), base(0), vector12(7), trigger(1), high(1), low(2), event(4))
    assert found == [(4098, 4, 5, 0)]
    assert edges == []


def test_events_before_the_first_row_or_base_are_dropped():
    assert decode(high(1), low(2), event(3), row(0), vector12(7))[0] == []


def test_events_in_rows_of_another_kind_are_skipped():
    assert decode(high(0), low(0), 0x1000 | 5, event(3), row(6), event(4))[0] == [(0, 4, 6, 0)]


@pytest.mark.parametrize("x", [0, 5, WIDTH - 32, WIDTH - 31, WIDTH - 20])
@pytest.mark.parametrize("counting", [False, True])
def test_triples_of_vectors_are_the_same_wherever_they_stand(x, counting):
    bits = [k % 3 == 0 and x + k < WIDTH for k in range(32)]
    value = sum(bit << k for k, bit in enumerate(bits))
    words = [
        base(x, 1),
        vector12(value & 0xFFF),
        vector12(value >> 12 & 0xFFF),
        vector8(value >> 24),
        base(0),
        vector8(1),
    ]
    expected = [*(x + k for k, bit in enumerate(bits) if bit), 0]
    if counting:
        image = np.zeros((2, HEIGHT, WIDTH), np.uint16)
        Evt3Decoder(WIDTH, HEIGHT).count(np.array([high(0), low(0), row(4), *words], np.uint16), image)
        assert np.flatnonzero(image[1, 4]).tolist() == expected[:-1]
        assert image.sum() == len(expected)
    else:
        assert [event_x for _, event_x, _, _ in decode(high(0), low(0), row(4), *words)[0]] == expected


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((row(0), event(1), row(HEIGHT)), "Row 720 lies outside the sensor of 1280 x 720"),
        ((row(0), event(1), event(WIDTH)), "column 1280 lies outside the sensor of 1280 x 720"),
        ((row(HEIGHT),), "Row 720 lies outside the sensor of 1280 x 720"),
        ((row(0), event(WIDTH)), "column 1280 lies outside the sensor of 1280 x 720"),
        (
            (row(0), base(WIDTH - 4), vector12(0b10000)),
            "vector that begins at column 1276 holds events beyond",
        ),
        ((row(0), base(WIDTH - 4), vector8(0b10000)), "vector that begins at column 1276 "),
        ((row(0), base(2047), vector12(1)), "vector that begins at column 2047 "),
        ((row(0), base(WIDTH - 20), vector12(1), vector12(1 << 8)), "vector that begins at column 1272 "),
        ((0x9000,), "type of word 0x9000 does not exist in EVT3"),
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


def test_events_before_a_malformed_word_are_handed_out():
    decoder = Evt3Decoder(WIDTH, HEIGHT)
    pieces = decoder.decode(np.array([high(0), low(0), row(0), event(7), 0x9000], np.uint16))
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


@pytest.mark.parametrize("x", [100, WIDTH - 12])
def test_events_of_one_pixel_add_up(x):
    image = np.zeros((2, HEIGHT, WIDTH), np.uint16)
    once = [base(x), vector12(0b101), event(x)]
    Evt3Decoder(WIDTH, HEIGHT).count(np.array([high(0), low(0), row(5), *once * 3], np.uint16), image)
    assert image[0, 5, x : x + 3].tolist() == [6, 0, 3]


def test_an_image_of_another_size_is_refused():
    with pytest.raises(ValueError, match="does not fit the sensor"):
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

"""The EVT3 decoder, word by word and on random streams."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.camera.evt3 import Events, Evt3Decoder, Triggers, count_events, empty_events
from drivers.camera.evt3_kernel import most_events
from drivers.errors import RecordingCorrupt

WIDTH, HEIGHT = 1280, 720
LOOP_US = 1 << 24


def high(value):
    return 0x8000 | value


def low(value):
    return 0x6000 | value


def row(y):
    return y


def event(x, p=0):
    return 0x2000 | p << 11 | x


def base(x, p=0):
    return 0x3000 | p << 11 | x


def vector12(bits):
    return 0x4000 | bits


def vector8(bits):
    return 0x5000 | bits


def trigger(value, channel=0):
    return 0xA000 | channel << 8 | value


def others(subtype, count, *, parts=3):
    payload = [0xF000 | count & 0xFFF, 0xF000 | count >> 12 & 0xFFF, 0x7000 | count >> 24 & 0xF]
    return [0xE000 | subtype, *payload[:parts]]


def rows(events):
    return list(zip(*(field.tolist() for field in events), strict=True))


def decode(*words, decoder=None, max_events=1_000_000):
    decoder = decoder or Evt3Decoder(WIDTH, HEIGHT)
    found, edges = [], []
    for events, triggers in decoder.decode(np.array(words, np.uint16), max_events=max_events):
        found += rows(events)
        edges += rows(triggers)
    return found, edges, decoder.told()


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
    _, edges, told = decode(*words)
    assert [value for _, value, _ in edges] == [k % 2 for k in range(10_000)]
    assert told.triggers == 10_000


def test_a_repeated_time_high_changes_nothing():
    assert decode(high(1), low(7), high(1), row(0), event(0))[0] == [(4103, 0, 0, 0)]


def test_a_new_time_high_starts_at_its_first_microsecond():
    assert decode(high(1), low(7), high(2), row(0), event(0))[0] == [(8192, 0, 0, 0)]


def test_the_clock_wraps_after_24_bits_and_times_go_on():
    found, _, told = decode(high(0xFFF), low(0xFFF), row(0), event(0), high(0), low(3), event(1))
    assert [t for t, *_ in found] == [LOOP_US - 1, LOOP_US + 3]
    assert told.gap_count == 0


def test_every_further_wrap_counts():
    words = [word for k in range(5) for word in (high(0xFFF), low(1), high(0), low(2))]
    assert decode(*words)[2].last_t_us == 5 * LOOP_US + 2


def test_time_low_stepping_back_by_some_microseconds_is_no_wrap():
    found, _, told = decode(high(1), low(20), row(0), event(0), low(9), event(1))
    assert [t for t, *_ in found] == [4116, 4105]
    assert told.back_steps == 1


def test_every_back_step_is_counted_and_a_repeated_time_is_none():
    assert decode(high(1), low(20), low(9), low(9), low(30), low(29))[2].back_steps == 2


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
    told = decode(high(10), low(100), high(12), low(0))[2]
    assert told.gaps == ((10 * 4096 + 100, 12 * 4096),)
    assert told.losses_in_words() == ("Words are missing from 41060 to 49152 us of the sensor's clock.",)


def test_gaps_beyond_the_kept_ones_are_counted():
    words = [word for k in range(100) for word in (high(2 * k), low(0))]
    told = decode(*words)[2]
    assert (told.gap_count, len(told.gaps)) == (99, 64)
    assert told.losses_in_words()[-1] == "35 more gaps follow."


def test_a_leap_over_the_wrap_is_a_gap_and_one_turn():
    told = decode(high(0xFFE), low(0), high(1), low(5))[2]
    assert told.gap_count == 1
    assert told.last_t_us == LOOP_US + 4096 + 5


def test_events_before_the_first_time_are_dropped_and_counted():
    found, edges, told = decode(row(5), event(3), base(0), vector12(7), trigger(1), high(1), low(2), event(4))
    assert found == [(4098, 4, 5, 0)]
    assert edges == []
    assert told.unplaced_events == 1 + 3 + 1


def test_events_before_the_first_row_or_base_are_dropped_and_counted():
    found, _, told = decode(high(1), low(2), event(3), row(0), vector12(7))
    assert (found, told.unplaced_events) == ([], 4)


def test_a_time_low_before_the_first_time_high_is_no_time():
    assert decode(low(5), row(0), event(0))[2].first_t_us == -1


def test_events_in_rows_of_another_kind_are_skipped():
    found, _, told = decode(high(0), low(0), 0x1000 | 5, event(3), row(6), event(4))
    assert found == [(0, 4, 6, 0)]
    assert told.unplaced_events == 1


@pytest.mark.parametrize("parts", [2, 3])
def test_rate_controller_counts_add_up_with_and_without_the_last_four_bits(parts):
    words = [
        *others(0x014, 5000, parts=parts),
        *others(0x016, 4000, parts=parts),
        *others(0x016, 1, parts=parts),
    ]
    found, _, told = decode(high(0), low(0), *words, row(0), event(1))
    assert (told.rate_controller_in, told.rate_controller_out) == (5000, 4001)
    assert len(found) == 1


def reported(*windows, parts=3):
    """A stream of windows of (events, events that the sensor says it sent), each with its report."""
    words = [high(0), low(0), row(0), *others(0x016, 123)]
    for events, counted in windows:
        words += [
            *[event(k) for k in range(events)],
            *others(0x014, counted + 5),
            *others(0x016, counted, parts=parts),
        ]
    return decode(*words)[2]


@pytest.mark.parametrize("parts", [2, 3])
def test_a_stream_that_has_what_the_sensor_counted_has_lost_nothing(parts):
    told = reported((3, 3), (0, 0), (7, 7), parts=parts)
    assert (told.lost_events, told.odd_windows, told.losses_in_words()) == (0, 0, ())


def test_events_that_the_sensor_counted_and_that_did_not_arrive_are_lost():
    told = reported((2, 6), (3, 3), (7, 7), (0, 1))
    assert (told.lost_events, told.odd_windows) == (5, 2)
    assert "5 are missing" in told.losses_in_words()[0]


@pytest.mark.parametrize(
    "stray", [[0xE016, 0x7003], [0xF005], [0x7001], [0xE016, 0xF000, 0xF000, 0xF001, 0x7001]]
)
def test_parts_of_a_payload_out_of_their_order_count_nowhere(stray):
    assert decode(*others(0x016, 3), *stray)[2].rate_controller_out == 3


def test_a_report_that_did_not_arrive_leaves_an_odd_window():
    told = reported((3, 3), (9, 4))
    assert (told.lost_events, told.odd_windows) == (0, 1)


def test_windows_over_several_pieces_are_counted_whole():
    decoder = Evt3Decoder(WIDTH, HEIGHT)
    words = [high(0), low(0), row(0), *others(0x016, 0), event(1), event(2), *others(0x016, 2)]
    for k in range(0, len(words), 2):
        decoder.tally(np.array(words[k : k + 2], np.uint16))
    assert decoder.told().odd_windows == 0


def test_rate_controller_counts_use_28_bits():
    assert decode(*others(0x016, 0xABCDEF1))[2].rate_controller_out == 0xABCDEF1


def test_payloads_of_other_subtypes_count_nowhere():
    told = decode(*others(0x016, 3), *others(0x0FF, 77), 0xD000, 0xF123, 0xF456)[2]
    assert told.rate_controller_out == 3


def test_a_sensor_that_does_not_report_its_rate_controller_is_not_taken_for_zero():
    assert decode(high(0), low(0))[2].rate_controller_in is None


def test_events_between_the_first_time_high_and_its_time_low_are_at_its_start():
    found, _, told = decode(row(3), high(2), event(7, 1), low(5), event(8))
    assert found == [(8192, 7, 3, 1), (8197, 8, 3, 0)]
    assert told.first_t_us == 8197


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
        ((row(0), event(1), row(HEIGHT)), "row 720 on a sensor of 1280 x 720"),
        ((row(0), event(1), event(WIDTH)), "column 1280 on a sensor of 1280 x 720"),
        ((row(HEIGHT),), "row 720 on a sensor of 1280 x 720"),
        ((row(0), event(WIDTH)), "column 1280 on a sensor of 1280 x 720"),
        ((row(0), base(WIDTH - 4), vector12(0b10000)), "vector from column 1276 on with events beyond"),
        ((row(0), base(WIDTH - 4), vector8(0b10000)), "vector from column 1276 on"),
        ((row(0), base(2047), vector12(1)), "vector from column 2047 on"),
        ((row(0), base(WIDTH - 20), vector12(1), vector12(1 << 8)), "vector from column 1272 on"),
        ((0x9000,), "0x9000 of a type that EVT3 does not have"),
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


# ---------------------------------------------------------------- random streams


@st.composite
def streams(draw):
    """Words of a well-formed stream, with the events, triggers and counters they stand for."""
    t = draw(st.integers(0, 3 * LOOP_US))
    words = [high(t >> 12 & 0xFFF), low(t & 0xFFF)]
    t &= LOOP_US - 1
    events, triggers, passed = [], [], 0
    for _ in range(draw(st.integers(0, 30))):
        kind = draw(st.sampled_from(["single", "vector", "vectors", "trigger", "wait", "counter"]))
        if kind == "wait":
            before, t = t, t + draw(st.integers(1, 20_000))
            words += [high(k & 0xFFF) for k in range((before >> 12) + 1, (t >> 12) + 1)]
            words.append(low(t & 0xFFF))
        elif kind == "single":
            x, y, p = (
                draw(st.integers(0, WIDTH - 1)),
                draw(st.integers(0, HEIGHT - 1)),
                draw(st.integers(0, 1)),
            )
            words += [row(y), event(x, p)]
            events.append((t, x, y, p))
        elif kind == "vector":
            x, y, p = (
                draw(st.integers(0, WIDTH - 32)),
                draw(st.integers(0, HEIGHT - 1)),
                draw(st.integers(0, 1)),
            )
            bits = draw(st.integers(0, 2**32 - 1))
            words += [
                row(y),
                base(x, p),
                vector12(bits & 0xFFF),
                vector12(bits >> 12 & 0xFFF),
                vector8(bits >> 24),
            ]
            events += [(t, x + k, y, p) for k in range(32) if bits >> k & 1]
        elif kind == "vectors":
            widths = draw(st.lists(st.sampled_from([12, 8]), max_size=6))
            x, p = draw(st.integers(0, WIDTH - sum(widths))), draw(st.integers(0, 1))
            y = draw(st.integers(0, HEIGHT - 1))
            words += [row(y), base(x, p)]
            for width in widths:
                bits = draw(st.integers(0, 2**width - 1))
                words.append(vector12(bits) if width == 12 else vector8(bits))
                events += [(t, x + k, y, p) for k in range(width) if bits >> k & 1]
                x += width
        elif kind == "trigger":
            value, channel = draw(st.integers(0, 1)), draw(st.integers(0, 15))
            words.append(trigger(value, channel))
            triggers.append((t, value, channel))
        else:
            count = draw(st.integers(0, 2**24 - 1))
            words += others(0x016, count, parts=draw(st.sampled_from([2, 3])))
            passed += count
    return words, events, triggers, passed


@given(streams())
def test_a_stream_decodes_to_what_was_put_in(stream):
    words, events, triggers, passed = stream
    found, edges, told = decode(*words)
    assert found == events
    assert edges == triggers
    assert (told.events, told.on_events) == (len(events), sum(p for *_, p in events))
    assert (told.rate_controller_out or 0) == passed
    assert (told.gap_count, told.unplaced_events) == (0, 0)


@given(streams(), st.lists(st.integers(0, 200), max_size=6), st.integers(32, 80))
def test_where_a_stream_is_cut_does_not_matter(stream, cuts, max_events):
    words, events, triggers, _ = stream
    decoder = Evt3Decoder(WIDTH, HEIGHT)
    found, edges = [], []
    bounds = [0, *sorted(min(cut, len(words)) for cut in cuts), len(words)]
    for begin, end in itertools.pairwise(bounds):
        piece, piece_edges, _ = decode(*words[begin:end], decoder=decoder, max_events=max_events)
        found += piece
        edges += piece_edges
    assert (found, edges) == (events, triggers)
    assert decoder.told() == decode(*words)[2]


@given(streams(), st.integers(32, 70))
def test_no_piece_is_larger_than_asked_for(stream, max_events):
    pieces = Evt3Decoder(WIDTH, HEIGHT).decode(np.array(stream[0], np.uint16), max_events=max_events)
    assert all(len(events.t) <= max_events for events, _ in pieces)


def sparse_words(rng, n):
    """Words of a sparse stream in random order: rows, single events and clock words, and now and then another."""
    words, t, upper = [high(3), low(5), row(1)], 5, 3
    while len(words) < n:
        match rng.choice(7, p=[0.3, 0.4, 0.2, 0.08, 0.008, 0.006, 0.006]):
            case 0:
                words.append(row(int(rng.integers(HEIGHT))) | int(rng.integers(2)) << 11)
            case 1:
                words.append(event(int(rng.integers(WIDTH)), int(rng.integers(2))))
            case 2:
                t = max(0, t + int(rng.choice([0, 3, 17, -9], p=[0.2, 0.5, 0.29, 0.01])))
                upper, t = upper + (t >> 12), t & 0xFFF
                words += [high(upper), low(t)]
            case 3:
                words.append(high(upper))
            case 4:
                words += others(0x016, int(rng.integers(300)))
            case 5:
                words += [0x1000 | int(rng.integers(HEIGHT)), event(2), row(4)]
            case 6:
                words += [base(int(rng.integers(WIDTH - 32)), 1), vector12(0x81), trigger(1)]
    return np.array(words, np.uint16)


@pytest.mark.parametrize("seed", range(4))
def test_long_stretches_of_a_sparse_stream_decode_as_their_words_one_by_one(seed):
    words = sparse_words(np.random.default_rng(seed), 6000)
    found, edges, told = decode(*words, max_events=700)
    one_by_one = Evt3Decoder(WIDTH, HEIGHT)
    pieces = [decode(word, decoder=one_by_one) for word in words]
    assert found == [one for piece in pieces for one in piece[0]]
    assert edges == [one for piece in pieces for one in piece[1]]
    assert told == one_by_one.told()
    assert told.back_steps > 0
    tallied, counted = Evt3Decoder(WIDTH, HEIGHT), Evt3Decoder(WIDTH, HEIGHT)
    image, expected = np.zeros((2, 2, HEIGHT, WIDTH), np.uint16)
    tallied.tally(words)
    counted.count(words, image)
    assert tallied.told() == counted.told() == told
    for _, x, y, p in found:
        expected[p, y, x] += 1
    assert np.array_equal(image, expected)


@pytest.mark.parametrize("wrong", [row(HEIGHT), event(WIDTH), low(1), 0x9000])
@pytest.mark.parametrize("place", [3, 40, 100, 163])
def test_a_malformed_word_is_found_where_it_stands_in_a_stretch(wrong, place):
    words = np.array([high(1), low(500), row(5), *[event(k) for k in range(160)]], np.uint16)
    with pytest.raises(RecordingCorrupt) as caught:
        decode(*np.insert(words, place, wrong))
    assert caught.value.offset == 2 * place


@settings(max_examples=30)
@given(streams())
def test_counting_without_a_list_gives_the_same_image(stream):
    words = np.array(stream[0], np.uint16)
    image = np.zeros((2, HEIGHT, WIDTH), np.uint16)
    edges = Evt3Decoder(WIDTH, HEIGHT).count(words, image)
    expected = np.zeros_like(image)
    for _, x, y, p in stream[1]:
        expected[p, y, x] += 1
    assert np.array_equal(image, expected)
    assert rows(edges) == stream[2]


@settings(max_examples=30)
@given(streams())
def test_events_of_a_list_count_to_the_image_that_their_words_do(stream):
    words = np.array(stream[0], np.uint16)
    expected, image = np.zeros((2, 2, HEIGHT, WIDTH), np.uint16)
    Evt3Decoder(WIDTH, HEIGHT).count(words, expected)
    for events, _ in Evt3Decoder(WIDTH, HEIGHT).decode(words, max_events=40):
        count_events(events, image)
    assert np.array_equal(image, expected)


@pytest.mark.parametrize(("x", "y", "p"), [(WIDTH, 0, 0), (0, HEIGHT, 0), (0, 0, 2)])
def test_an_event_outside_the_image_is_not_counted_but_refused(x, y, p):
    image = np.zeros((2, HEIGHT, WIDTH), np.uint16)
    events = Events(
        *(np.array([v], kind) for v, kind in zip((0, x, y, p), ("i8", "u2", "u2", "u1"), strict=True))
    )
    with pytest.raises(ValueError, match="outside"):
        count_events(events, image)
    assert not image.any()


@pytest.mark.parametrize("missing", ["row", "base"])
def test_events_without_a_place_count_nowhere(missing):
    image = np.zeros((2, HEIGHT, WIDTH), np.uint16)
    decoder = Evt3Decoder(WIDTH, HEIGHT)
    words = [high(0), low(0), base(5) if missing == "row" else row(5), vector12(7), event(9) | 0x800]
    decoder.count(np.array(words, np.uint16), image)
    assert image.sum() == (0 if missing == "row" else 1)
    assert decoder.told().unplaced_events == (4 if missing == "row" else 3)


@pytest.mark.parametrize("x", [100, WIDTH - 12])
def test_events_of_one_pixel_add_up(x):
    image = np.zeros((2, HEIGHT, WIDTH), np.uint16)
    once = [base(x), vector12(0b101), event(x)]
    Evt3Decoder(WIDTH, HEIGHT).count(np.array([high(0), low(0), row(5), *once * 3], np.uint16), image)
    assert image[0, 5, x : x + 3].tolist() == [6, 0, 3]


def test_an_image_of_another_size_is_refused():
    with pytest.raises(ValueError, match="another sensor"):
        Evt3Decoder(WIDTH, HEIGHT).count(np.array([high(0)], np.uint16), np.zeros((2, 10, 10), np.uint16))


@given(streams())
def test_tallying_tells_the_same_as_decoding(stream):
    decoder = Evt3Decoder(WIDTH, HEIGHT)
    edges = decoder.tally(np.array(stream[0], np.uint16))
    assert decoder.told() == decode(*stream[0])[2]
    assert rows(edges) == stream[2]


@given(st.binary(max_size=400))
def test_garbage_ends_in_an_error_or_in_events_inside_the_sensor(data):
    words = np.frombuffer(data[: len(data) // 2 * 2], "<u2")
    decoder = Evt3Decoder(WIDTH, HEIGHT)
    pieces: list[tuple[Events, Triggers]] = []
    refused_at = None
    try:
        pieces.extend(decoder.decode(words))
    except RecordingCorrupt as error:
        refused_at = error.offset
    if refused_at is not None:
        assert words[refused_at // 2] >> 12 not in (0x7, 0xA, 0xD, 0xE, 0xF)
    for events, _ in pieces:
        assert (events.x < WIDTH).all()
        assert (events.y < HEIGHT).all()
        assert (events.p <= 1).all()
        assert (events.t >= 0).all()
        assert len(events.t) <= 6 * len(data)


def test_the_clock_covered_counts_from_the_first_time_word():
    decoder = Evt3Decoder(WIDTH, HEIGHT)
    assert decoder.covered_us == 0
    decoder.tally(np.array([high(5), low(10)], np.uint16))
    assert decoder.covered_us == 0
    decoder.tally(np.array([high(6), low(20)], np.uint16))
    assert decoder.covered_us == 4096 + 10
    assert decoder.told().duration_s == pytest.approx(4106e-6)


@given(streams(), st.integers(0, 5))
def test_decoding_into_given_arrays_gives_the_same(stream, at):
    words, events, triggers, _ = stream
    out = empty_events(at + len(events) + 32)
    end, edges = Evt3Decoder(WIDTH, HEIGHT).decode_into(np.array(words, np.uint16), out, at)
    assert rows(out.part(at, end)) == events
    assert rows(edges) == triggers


def test_arrays_without_room_are_refused():
    words = np.array([high(0), low(0), row(0), *[event(k) for k in range(40)]], np.uint16)
    with pytest.raises(ValueError, match="no room"):
        Evt3Decoder(WIDTH, HEIGHT).decode_into(words, empty_events(50), 0)


def test_decoding_into_arrays_refuses_a_malformed_first_word():
    with pytest.raises(RecordingCorrupt) as caught:
        Evt3Decoder(WIDTH, HEIGHT).decode_into(np.array([0x9000], np.uint16), empty_events(50), 0)
    assert caught.value.offset == 0


@given(streams())
def test_events_can_be_counted_without_decoding(stream):
    assert most_events(np.array(stream[0], np.uint16)) == len(stream[1])

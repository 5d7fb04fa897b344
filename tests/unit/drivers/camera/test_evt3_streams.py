"""The EVT3 decoder on random streams: however they are cut, read or spoiled."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.camera.event_arrays import Events, Triggers, empty_events
from drivers.camera.evt3 import Evt3Decoder
from drivers.camera.evt3_kernel import max_event_count
from drivers.errors import RecordingCorrupt
from tests.unit.drivers.camera import evt3_words as word
from tests.unit.drivers.camera.evt3_words import HEIGHT, LOOP_US, WIDTH


@st.composite
def streams(draw):
    """Words of a well-formed stream, with the events, triggers and counters they stand for."""
    t = draw(st.integers(0, 3 * LOOP_US))
    words = [word.high(t >> 12 & 0xFFF), word.low(t & 0xFFF)]
    t &= LOOP_US - 1
    events, triggers, passed = [], [], 0
    for _ in range(draw(st.integers(0, 30))):
        kind = draw(st.sampled_from(["single", "vector", "vectors", "trigger", "wait", "counter"]))
        if kind == "wait":
            before, t = t, t + draw(st.integers(1, 20_000))
            words += [word.high(k & 0xFFF) for k in range((before >> 12) + 1, (t >> 12) + 1)]
            words.append(word.low(t & 0xFFF))
        elif kind == "single":
            x, y, p = (draw(st.integers(0, last)) for last in (WIDTH - 1, HEIGHT - 1, 1))
            words += [word.row(y), word.event(x, p)]
            events.append((t, x, y, p))
        elif kind == "vector":
            x, y, p = (draw(st.integers(0, last)) for last in (WIDTH - 32, HEIGHT - 1, 1))
            bits = draw(st.integers(0, 2**32 - 1))
            words += [
                word.row(y),
                word.base(x, p),
                word.vector12(bits & 0xFFF),
                word.vector12(bits >> 12 & 0xFFF),
                word.vector8(bits >> 24),
            ]
            events += [(t, x + k, y, p) for k in range(32) if bits >> k & 1]
        elif kind == "vectors":
            widths = draw(st.lists(st.sampled_from([12, 8]), max_size=6))
            x, p = draw(st.integers(0, WIDTH - sum(widths))), draw(st.integers(0, 1))
            y = draw(st.integers(0, HEIGHT - 1))
            words += [word.row(y), word.base(x, p)]
            for width in widths:
                bits = draw(st.integers(0, 2**width - 1))
                words.append(word.vector12(bits) if width == 12 else word.vector8(bits))
                events += [(t, x + k, y, p) for k in range(width) if bits >> k & 1]
                x += width
        elif kind == "trigger":
            value, channel = draw(st.integers(0, 1)), draw(st.integers(0, 15))
            words.append(word.trigger(value, channel))
            triggers.append((t, value, channel))
        else:
            count = draw(st.integers(0, 2**24 - 1))
            words += word.others(0x016, count, parts=draw(st.sampled_from([2, 3])))
            passed += count
    return words, events, triggers, passed


@given(streams())
def test_a_stream_decodes_to_what_was_put_in(stream):
    words, events, triggers, passed = stream
    decoded, edges, statistics = word.decode(*words)
    assert decoded == events
    assert edges == triggers
    assert (statistics.events, statistics.on_events) == (len(events), sum(p for *_, p in events))
    assert (statistics.rate_controller_out or 0) == passed
    assert statistics.gap_count == 0


@given(streams(), st.lists(st.integers(0, 200), max_size=6), st.integers(32, 80))
def test_where_a_stream_is_cut_does_not_matter(stream, cuts, max_events):
    words, events, triggers, _ = stream
    decoder = Evt3Decoder(WIDTH, HEIGHT)
    decoded, edges = [], []
    bounds = [0, *sorted(min(cut, len(words)) for cut in cuts), len(words)]
    for begin, end in itertools.pairwise(bounds):
        piece, piece_edges, _ = word.decode(*words[begin:end], decoder=decoder, max_events=max_events)
        decoded += piece
        edges += piece_edges
    assert (decoded, edges) == (events, triggers)
    assert decoder.statistics() == word.decode(*words)[2]


@given(streams(), st.integers(32, 70))
def test_no_piece_is_larger_than_asked_for(stream, max_events):
    pieces = Evt3Decoder(WIDTH, HEIGHT).decode([np.array(stream[0], np.uint16)], max_events=max_events)
    assert all(len(events.t) <= max_events for events, _ in pieces)


def sparse_words(rng, n):
    """Words of a sparse stream in random order: rows, single events and clock words, and now and then another."""
    words, t, upper = [word.high(3), word.low(5), word.row(1)], 5, 3
    while len(words) < n:
        match rng.choice(7, p=[0.3, 0.4, 0.2, 0.08, 0.008, 0.006, 0.006]):
            case 0:
                words.append(word.row(int(rng.integers(HEIGHT))) | int(rng.integers(2)) << 11)
            case 1:
                words.append(word.event(int(rng.integers(WIDTH)), int(rng.integers(2))))
            case 2:
                t = max(0, t + int(rng.choice([0, 3, 17, -9], p=[0.2, 0.5, 0.29, 0.01])))
                upper, t = upper + (t >> 12), t & 0xFFF
                words += [word.high(upper), word.low(t)]
            case 3:
                words.append(word.high(upper))
            case 4:
                words += word.others(0x016, int(rng.integers(300)))
            case 5:
                words += [0x1000 | int(rng.integers(HEIGHT)), word.event(2), word.row(4)]
            case 6:
                words += [word.base(int(rng.integers(WIDTH - 32)), 1), word.vector12(0x81), word.trigger(1)]
    return np.array(words, np.uint16)


@pytest.mark.parametrize("seed", range(4))
def test_long_stretches_of_a_sparse_stream_decode_as_their_words_one_by_one(seed):
    words = sparse_words(np.random.default_rng(seed), 6000)
    decoded, edges, statistics = word.decode(*words, max_events=700)
    one_by_one = Evt3Decoder(WIDTH, HEIGHT)
    pieces = [word.decode(each, decoder=one_by_one) for each in words]
    assert decoded == [event_row for piece in pieces for event_row in piece[0]]
    assert edges == [edge_row for piece in pieces for edge_row in piece[1]]
    assert statistics == one_by_one.statistics()
    image, expected = np.zeros((2, 2, HEIGHT, WIDTH), np.uint16)
    counted = Evt3Decoder(WIDTH, HEIGHT)
    counted.count(words, image)
    assert counted.statistics() == statistics
    for _, x, y, p in decoded:
        expected[p, y, x] += 1
    assert np.array_equal(image, expected)


@pytest.mark.parametrize("wrong", [word.row(HEIGHT), word.event(WIDTH), word.low(1), 0x9000])
@pytest.mark.parametrize("place", [3, 40, 100, 163])
def test_a_malformed_word_is_found_where_it_stands_in_a_stretch(wrong, place):
    words = [word.high(1), word.low(500), word.row(5), *[word.event(k) for k in range(160)]]
    words = np.array(words, np.uint16)
    with pytest.raises(RecordingCorrupt) as caught:
        word.decode(*np.insert(words, place, wrong))
    assert caught.value.offset == 2 * place


@settings(max_examples=50)
@given(streams(), st.integers(0, 5))
def test_every_way_to_read_a_stream_tells_the_same(stream, at):
    words, (_, events, triggers, _) = np.array(stream[0], np.uint16), stream
    assert max_event_count(words) == len(events)
    tallied, counted, filled = (Evt3Decoder(WIDTH, HEIGHT) for _ in range(3))
    image, expected = np.zeros((2, 2, HEIGHT, WIDTH), np.uint16)
    for _, x, y, p in events:
        expected[p, y, x] += 1
    out = empty_events(at + len(events) + 32)
    end, edges = filled.decode_into(words, out, at)
    assert word.rows(out.part(at, end)) == events
    for edges_found in (edges, tallied.tally(words), counted.count(words, image)):
        assert word.rows(edges_found) == triggers
    assert np.array_equal(image, expected)
    assert tallied.statistics() == counted.statistics() == filled.statistics() == word.decode(*words)[2]


@given(st.binary(max_size=400))
def test_garbage_ends_in_an_error_or_in_events_inside_the_sensor(data):
    words = np.frombuffer(data[: len(data) // 2 * 2], "<u2")
    decoder = Evt3Decoder(WIDTH, HEIGHT)
    pieces: list[tuple[Events, Triggers]] = []
    refused_at = None
    try:
        pieces.extend(decoder.decode([words]))
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

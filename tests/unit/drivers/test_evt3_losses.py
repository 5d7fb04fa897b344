"""Losses that the sensor's rate controller lets the EVT3 decoder notice."""

import numpy as np
import pytest

from drivers.camera.evt3 import Evt3Decoder
from tests.unit.drivers.evt3_words import HEIGHT, WIDTH, decode, event, high, low, others, row


@pytest.mark.parametrize("parts", [2, 3])
def test_rate_controller_counts_add_up_with_and_without_the_last_four_bits(parts):
    words = [
        *others(0x014, 5000, parts=parts),
        *others(0x016, 4000, parts=parts),
        *others(0x016, 1, parts=parts),
    ]
    found, _, statistics = decode(high(0), low(0), *words, row(0), event(1))
    assert (statistics.rate_controller_in, statistics.rate_controller_out) == (5000, 4001)
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


def test_windows_over_several_pieces_are_counted_whole():
    decoder = Evt3Decoder(WIDTH, HEIGHT)
    words = [high(0), low(0), row(0), *others(0x016, 0), event(1), event(2), *others(0x016, 2)]
    for k in range(0, len(words), 2):
        decoder.tally(np.array(words[k : k + 2], np.uint16))
    assert decoder.statistics().mismatched_windows == 0


def test_rate_controller_counts_use_28_bits():
    assert decode(*others(0x016, 0xABCDEF1))[2].rate_controller_out == 0xABCDEF1


def test_payloads_of_other_subtypes_count_nowhere():
    statistics = decode(*others(0x016, 3), *others(0x0FF, 77), 0xD000, 0xF123, 0xF456)[2]
    assert statistics.rate_controller_out == 3


def test_a_sensor_that_does_not_report_its_rate_controller_is_not_taken_for_zero():
    assert decode(high(0), low(0))[2].rate_controller_in is None

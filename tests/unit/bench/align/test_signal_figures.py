"""Signal figures from made-up events and sync edges, whose truth is known exactly."""

import numpy as np
import pytest

from bench.align.live_image import LINK_GBIT_S, burst_jitter_us, measure_signal
from calib.events.flicker import Flicker
from drivers.camera.event_arrays import Events, Triggers

PERIOD_US = 16_667


def events_of(bursts_us, each=400, spread_us=200.0):
    """ON bursts at some times, and OFF bursts half a period later."""
    random = np.random.default_rng(4)
    on = np.concatenate([at + random.normal(0.0, spread_us, each) for at in bursts_us])
    off = np.concatenate([at + PERIOD_US / 2 + random.normal(0.0, spread_us, each // 2) for at in bursts_us])
    t = np.concatenate([on, off])
    p = np.concatenate([np.ones(len(on), np.uint8), np.zeros(len(off), np.uint8)])
    order = np.argsort(t)
    place = np.zeros(len(t), np.uint16)
    return Events(np.maximum(t[order], 0.0).astype(np.int64), place, place, p[order])


def triggers_of(times_us, values):
    return Triggers(
        t=np.array(times_us, np.int64), id=np.zeros(len(times_us), np.uint8), value=np.array(values, np.uint8)
    )


def edges(count, jitter_us=0.0):
    """Rising and falling sync edges of some periods."""
    random = np.random.default_rng(5)
    up = 1000.0 + PERIOD_US * np.arange(count)
    t = np.column_stack([up, up + PERIOD_US / 2]).ravel() + random.normal(0.0, jitter_us, 2 * count)
    return triggers_of(t, np.tile([1, 0], count))


def test_rates_and_frequencies():
    found = measure_signal(events_of(2000 + PERIOD_US * np.arange(12)), edges(12), 1_000_000, 60.0)
    assert found.trigger_hz == pytest.approx(1e6 / PERIOD_US, rel=1e-6)
    assert found.event_hz == pytest.approx(1e6 / PERIOD_US, rel=1e-3)
    assert found.on_share == pytest.approx(2 / 3)
    assert (found.triggers, found.triggers_expected) == (12, 12)
    duration_s = 12 * PERIOD_US * 1e-6
    assert found.events_per_s == pytest.approx(12 * 600 / duration_s, rel=0.05)
    assert found.link_share == pytest.approx(8e-3 / (duration_s * LINK_GBIT_S), rel=0.05)
    assert found.jitter_us == pytest.approx(0.3, abs=0.3)
    assert found.sync_fault == ""


def test_the_jitter_of_the_sync_is_the_drawn_one():
    found = measure_signal(events_of(2000 + PERIOD_US * np.arange(40)), edges(40, jitter_us=25.0), 1000, None)
    assert found.jitter_us == pytest.approx(25.0, rel=0.25)


def test_the_jitter_of_the_bursts_is_the_drawn_one():
    random = np.random.default_rng(6)
    at = 4000 + PERIOD_US * np.arange(60) + random.normal(0.0, 80.0, 60)
    flicker = Flicker(PERIOD_US, 4000.0, 0.5, 0.0, 0, "triggers")
    assert burst_jitter_us(events_of(at), flicker) == pytest.approx(80.0, rel=0.3)
    assert burst_jitter_us(events_of(at[:2]), flicker) is None
    assert burst_jitter_us(EMPTY, flicker) is None


EMPTY = Events(np.zeros(0, np.int64), np.zeros(0, np.uint16), np.zeros(0, np.uint16), np.zeros(0, np.uint8))


def test_missing_sync_edges_are_counted():
    some = edges(12)
    kept = [0, 1, 2, 3, 20, 21, 22, 23]
    found = measure_signal(
        events_of(2000 + PERIOD_US * np.arange(12)), triggers_of(some.t[kept], some.value[kept]), 1000, 60.0
    )
    assert (found.triggers, found.triggers_expected) == (4, 12)


def test_nothing_is_nothing():
    none = triggers_of([], [])
    found = measure_signal(EMPTY, none, 0, 60.0)
    assert found.flicker is None
    assert (found.events_per_s, found.link_share, found.on_share, found.trigger_hz) == (
        None,
        None,
        None,
        None,
    )


def test_edges_without_a_period_are_named():
    odd = triggers_of([1000, 1700, 9000, 9800, 40_000, 41_000], [1, 0, 1, 0, 1, 0])
    found = measure_signal(events_of(2000 + PERIOD_US * np.arange(4)), odd, 1000, 60.0)
    assert found.sync_fault


def test_a_short_slice_takes_the_set_frequency_for_its_image_only():
    found = measure_signal(events_of([3000.0]), triggers_of([], []), 1000, 60.0)
    assert found.flicker.frequency_hz == pytest.approx(60.0)
    assert (found.trigger_hz, found.event_hz) == (None, None)

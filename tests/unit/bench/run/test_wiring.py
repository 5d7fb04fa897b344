"""The self-test of the sync cable names each fault, and none where there is none."""

import numpy as np
import pytest

from bench.run.wiring import BRIGHT_S, DUTY_PERCENT, FREQUENCY_HZ, judge
from drivers.camera.event_arrays import Events, Triggers

PERIOD_US = 1e6 / FREQUENCY_HZ
N = round(BRIGHT_S * FREQUENCY_HZ)


def edges_of(*, inverted=False, channel=0, kept=1.0, times=1, n=N):
    rise = np.arange(n * times) * PERIOD_US / times
    t = np.concatenate([rise, rise + DUTY_PERCENT / 100 * PERIOD_US / times]).astype(np.int64)
    value = np.repeat([1, 0], len(rise)).astype(np.uint8) ^ np.uint8(inverted)
    order = np.argsort(t)
    order = order[np.random.default_rng(1).random(len(order)) < kept]
    return Triggers(t[order], value[order], np.full(len(order), channel, np.uint8))


def events_of(n=N):
    rise = np.arange(n) * PERIOD_US
    bursts = np.linspace(500, 3000, 40)
    on = (rise[:, None] + bursts).ravel()
    off = on + DUTY_PERCENT / 100 * PERIOD_US
    t = np.concatenate([on, off]).astype(np.int64)
    p = np.repeat([1, 0], len(on)).astype(np.uint8)
    order = np.argsort(t)
    zeros = np.zeros(len(t), np.uint16)
    return Events(t[order], zeros, zeros, p[order])


NO_EVENTS = events_of(n=0)
NO_EDGES = edges_of(n=0)


def noise(n=20_000):
    chance = np.random.default_rng(2)
    t = np.sort(chance.integers(0, int(BRIGHT_S * 1e6), n))
    zeros = np.zeros(n, np.uint16)
    return Events(t, zeros, zeros, chance.integers(0, 2, n).astype(np.uint8))


@pytest.mark.parametrize(
    ("events", "edges", "names"),
    [
        (events_of(), edges_of(), []),
        (events_of(), NO_EDGES, ["trigger cable missing"]),
        (events_of(), edges_of(inverted=True), ["inverted"]),
        (events_of(), edges_of(channel=1), ["wrong channel"]),
        (events_of(), edges_of(channel=6, inverted=True), ["wrong channel", "inverted"]),
        (events_of(), edges_of(kept=0.7), ["sync level"]),
        (events_of(), edges_of(times=3), ["wrong source"]),
        (NO_EVENTS, edges_of(), ["no light"]),
        (noise(), edges_of(), ["no light"]),
        (NO_EVENTS, edges_of(inverted=True), ["inverted", "no light"]),
        (NO_EVENTS, NO_EDGES, ["no light and no trigger"]),
    ],
)
def test_each_fault_has_its_name_and_a_remedy(events, edges, names):
    report = judge(NO_EDGES, events, edges)
    assert [fault.name for fault in report.faults] == names
    assert all(fault.remedy.endswith(".") for fault in report.faults)

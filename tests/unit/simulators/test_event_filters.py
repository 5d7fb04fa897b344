"""The on-chip event filters: which events of a flicker each of them passes."""

import numpy as np
import pytest

from simulators.pixels.event_filters import ERC_QUOTA, EventFilters
from simulators.pixels.sensor import Events, simulate
from simulators.world.truth import NOISE_LEVELS
from simulators.world.world import LightState


def stream(rows):
    t, x, y, p = np.array(rows).T
    return Events(t.astype(np.int64), x.astype(np.uint16), y.astype(np.uint16), p.astype(np.uint8))


def flicker(frequency_hz, seconds=0.2, waveform="sine"):
    light = LightState(waveform=waveform, frequency_hz=frequency_hz, output=True)
    scene = np.random.default_rng(0).random((48, 64)).astype(np.float32)
    return simulate(scene, light, seconds * 1e6, noise=NOISE_LEVELS["clean"])


def test_without_a_filter_everything_passes():
    events = flicker(60.0)
    left, entered = EventFilters(64, 48, {"afk": False}).apply(events)
    assert left is events
    assert entered is events.t


BURSTS = stream(
    [
        (100, 5, 5, 1),
        (300, 5, 5, 1),
        (400, 6, 5, 1),
        (900, 5, 5, 1),
        (5000, 5, 5, 0),
        (5100, 5, 5, 0),
        (99_000, 5, 5, 0),
    ]
)


def test_trail_keeps_the_first_event_of_a_burst():
    left, _ = EventFilters(64, 48, {"trail": True}).apply(BURSTS)
    assert left.t.tolist() == [100, 400, 5000, 99_000]


def test_stc_drops_the_first_event_of_a_burst():
    left, _ = EventFilters(64, 48, {"stc": True}).apply(BURSTS)
    assert left.t.tolist() == [300, 900, 5100]


@pytest.mark.parametrize(("frequency_hz", "deleted"), [(20.0, False), (60.0, True), (200.0, True)])
def test_afk_deletes_a_flicker_inside_its_band(frequency_hz, deleted):
    events = flicker(frequency_hz)
    left, _ = EventFilters(64, 48, {"afk": True}).apply(events)
    late = np.count_nonzero(left.t > 1e5) / np.count_nonzero(events.t > 1e5)
    assert (late < 0.05) if deleted else (late > 0.95)


def test_the_rate_controller_keeps_its_quota_and_reports_all_that_entered():
    rng = np.random.default_rng(0)
    t = np.sort(rng.integers(0, 1000, 30_000))
    events = Events(t, *(rng.integers(0, 40, 30_000).astype(k) for k in (np.uint16, np.uint16, np.uint8)))
    left, entered = EventFilters(64, 48, {"erc": True}).apply(events)
    assert np.bincount(left.t // 200).tolist() == [ERC_QUOTA] * 5
    assert len(entered) == 30_000


@pytest.mark.parametrize("name", ["afk", "stc", "trail", "erc"])
def test_slicing_does_not_change_what_is_left(name):
    events = flicker(60.0, waveform="square")
    whole, _ = EventFilters(64, 48, {name: True}).apply(events)
    filters = EventFilters(64, 48, {name: True})
    parts = []
    for begin in range(0, 200_000, 7_300):
        inside = slice(*np.searchsorted(events.t, [begin, begin + 7_300]))
        parts.append(filters.apply(Events(*(a[inside] for a in events)))[0])
    for k in range(4):
        np.testing.assert_array_equal(np.concatenate([p[k] for p in parts]), whole[k])
    assert 0 < len(whole.t) <= len(events.t)

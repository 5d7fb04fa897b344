"""The sensor: against an equation solved step by step, and against what every event sensor obeys."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from simulators.biases import ALLOWED, PixelSettings
from simulators.errors import SimulationMisuse
from simulators.pixels import Link, Sensor, simulate
from simulators.truth import NOISE_LEVELS, NoiseTruth
from simulators.world import LightState

MISMATCH_ONLY = NoiseTruth(mismatch=0.12, background_hz=0.0, hot_share=0.0, hot_hz=0.0, reset_noise=0.0)
SQUARE = LightState(waveform="square", output=True)
SINE = LightState(waveform="sine", output=True)


def picture(height, width, seed=0):
    return np.random.default_rng(seed).random((height, width)).astype(np.float32)


def by_pixel(events, x, y):
    inside = (events.x == x) & (events.y == y)
    return events.t[inside], events.p[inside]


@njit
def solve_step_by_step(
    light, period, phase_us, shape, low, high, duty, ambient, q, on, off, dead, begin, end
):
    """du/dt = (1 - I u) / q in steps of 0.02 us; events of one pixel from ``begin`` (a reset) to ``end``.

    Crossings and new references are interpolated within a step: in the flat tail of an edge an event's time
    answers to 1e-5 of the reference with a microsecond.
    """
    step = 0.02
    begin_t, live = begin - 4 * period, begin
    v = np.log(ambient + light * low)
    u = np.exp(-v)
    reference, waiting = 0.0, True
    times, polarities = [0.0 for _ in range(0)], [0 for _ in range(0)]
    for i in range(int((end - begin_t) / step)):
        t = begin_t + i * step  # at the step's end: t + step
        share = ((t + 0.5 * step + phase_us) / period) % 1.0
        if shape == 0:
            w = high if share < duty else low
        else:
            w = 0.5 * (low + high) + 0.5 * (high - low) * np.sin(2.0 * np.pi * share)
        intensity = ambient + light * w
        middle = u + 0.5 * step * (1.0 - intensity * u) / q
        u += step * (1.0 - intensity * middle) / q  # midpoint rule
        before, v = v, -np.log(u)
        if t + step < live:
            continue
        if waiting:
            reference, waiting = before + (v - before) * (live - t) / step, False
        if v - reference >= on or reference - v >= off:
            level = reference + on if v > reference else reference - off
            times.append(t + step * (level - before) / (v - before))
            polarities.append(1 if v > reference else 0)
            live, waiting = times[-1] + dead, True
    return times, polarities


@pytest.mark.parametrize(("light", "shape", "tolerance_us"), [(SQUARE, 0, 1.0), (SINE, 1, 2.0)])
@pytest.mark.parametrize("q_us", [20.0, 60.0, 200.0])
def test_events_are_those_of_the_differential_equation(light, shape, tolerance_us, q_us):
    height, width, duration, phase = 10, 1, 33_400.0, 0.37
    setting = PixelSettings(q_us=q_us)
    scene = picture(height, width, seed=int(q_us))
    sensor = Sensor(width, height, noise=MISMATCH_ONLY, settings=setting, camera_seed=3, link=Link.ideal())
    sensor.begin(scene, light, phase)
    events = sensor.run(duration)
    on, off = sensor.thresholds
    period = light.period_us
    compared = 0
    for y in range(height):
        times, polarities = solve_step_by_step(
            float(scene[y, 0]), period, phase * period, shape, light.low, light.high, 0.5, setting.ambient,
            q_us, on[y, 0], off[y, 0], setting.dead_us, -2 * period, duration,
        )  # fmt: skip
        expected = [(t, p) for t, p in zip(times, polarities, strict=True) if t >= 0.0]
        found_t, found_p = by_pixel(events, 0, y)
        assert list(found_p) == [p for _, p in expected]
        # the sensor rounds down to whole microseconds
        error = found_t + 0.5 - np.array([t for t, _ in expected])
        assert np.abs(error).max(initial=0.0) <= 0.5 + tolerance_us
        compared += len(expected)
    assert compared > 50


@given(
    seed=st.integers(0, 1000),
    waveform=st.sampled_from(["square", "sine"]),
    frequency=st.floats(20, 500),
    low=st.floats(0, 2),
    noise=st.sampled_from(["none", "clean", "typical", "heavy"]),
    refr=st.integers(*ALLOWED["bias_refr"]),
)
@settings(max_examples=25, deadline=None)
def test_what_every_recording_obeys(seed, waveform, frequency, low, noise, refr):
    light = LightState(waveform=waveform, frequency_hz=frequency, low_v=low, output=True)
    setting = PixelSettings.from_biases({"bias_refr": refr})
    events = simulate(
        picture(48, 64, seed), light, 20_000, noise=NOISE_LEVELS[noise], settings=setting, seed=seed
    )
    assert (np.diff(events.t) >= 0).all(), "time is monotone"
    assert events.t.min(initial=0) >= 0
    assert events.t.max(initial=0) < 20_000
    assert events.x.max(initial=0) < 64
    assert events.y.max(initial=0) < 48
    order = np.lexsort((events.t, events.x, events.y))
    same = np.diff(events.y[order].astype(int) * 64 + events.x[order]) == 0
    waits = np.diff(events.t[order])[same]
    assert waits.min(initial=10**6) >= setting.dead_us - 1.01, "a pixel is dead after a read"


@given(seed=st.integers(0, 1000), cuts=st.lists(st.integers(1, 39_999), max_size=6, unique=True))
@settings(max_examples=15, deadline=None)
def test_slicing_does_not_change_the_stream(seed, cuts):
    def begun():
        sensor = Sensor(64, 48, noise=NOISE_LEVELS["heavy"], seed=seed)
        sensor.begin(picture(48, 64, seed), SQUARE, 0.2)
        return sensor

    whole = begun().run(40_000)
    sensor = begun()
    parts = [sensor.run(t) for t in [*sorted(cuts), 40_000]]
    for k in range(4):
        np.testing.assert_array_equal(np.concatenate([p[k] for p in parts]), whole[k])


def test_the_same_seed_gives_the_same_events_and_another_does_not():
    a, b, c = (simulate(picture(48, 64), SQUARE, 20_000, seed=s) for s in (4, 4, 5))
    assert all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))
    assert not np.array_equal(a.t, c.t)


def test_a_row_is_read_at_one_time_and_only_once_at_a_time():
    events = simulate(np.ones((48, 64), np.float32), SQUARE, 17_000, noise=NOISE_LEVELS["clean"])
    per_read = {}
    for t, y in zip(events.t, events.y, strict=True):
        per_read[t, y] = per_read.get((t, y), 0) + 1
    assert max(per_read.values()) > 32  # whole rows ask at once, and leave together
    assert len(events.t) > 48 * 64


def test_the_readout_never_beats_its_peak_rate():
    events = simulate(np.ones((360, 640), np.float32), SQUARE, 34_000)
    counts = np.bincount(events.t // 100)
    assert counts.max() <= 1066 * 100 + 640  # one row may straddle the bin's edge
    assert counts.max() > 0.5 * 1066 * 100


def test_waiting_for_the_readout_costs_events():
    scene = np.ones((96, 640), np.float32)
    slow = Link(row_us=8.0, event_us=0.008)  # as long a sweep as the whole sensor's
    ideal = simulate(scene, SQUARE, 17_000, noise=NOISE_LEVELS["clean"], link=Link.ideal())
    real = simulate(scene, SQUARE, 17_000, noise=NOISE_LEVELS["clean"], link=slow)
    assert len(real.t) < 0.6 * len(ideal.t)


def test_a_slow_link_stalls_the_readout_and_loses_events():
    scene = np.ones((48, 320), np.float32)

    def taken(link):
        sensor = Sensor(320, 48, noise=NOISE_LEVELS["clean"], link=link)
        sensor.begin(scene, SQUARE, 0.0)
        return len(sensor.run(17_000).t), sensor.stalled_us

    fast, none = taken(Link())
    slow, stalled = taken(Link(words_us=0.3, fifo_words=2048))
    assert none == 0.0
    assert stalled > 1000.0
    assert slow < 0.8 * fast


@pytest.mark.parametrize("light", [LightState(output=False), LightState(low_v=5.0, high_v=5.0, output=True)])
def test_a_steady_light_leaves_background_events_only_without_bias(light):
    noise = NoiseTruth(mismatch=0.12, background_hz=20.0, hot_share=0.0, hot_hz=0.0, reset_noise=0.01)
    width, height, seconds = 64, 48, 1.0
    events = simulate(picture(height, width), light, seconds * 1e6, noise=noise, seed=2)
    expected = 20.0 * width * height * seconds
    assert abs(len(events.t) - expected) < 3.0 * np.sqrt(expected) + 0.03 * expected  # the spread's own mean
    assert abs(events.p.mean() - 0.5) < 3.0 * 0.5 / np.sqrt(expected)
    first_half = np.count_nonzero(events.t < seconds * 5e5)
    assert abs(first_half - len(events.t) / 2) < 3.0 * np.sqrt(len(events.t)) / 2


def test_hot_pixels_stay_where_they_are_over_seeds_and_move_with_the_camera():
    noise = NoiseTruth(mismatch=0.0, background_hz=0.0, hot_share=2e-3, hot_hz=2000.0, reset_noise=0.0)
    dark = LightState(output=False)

    def hot(camera_seed, seed):
        events = simulate(picture(48, 64), dark, 5e4, noise=noise, camera_seed=camera_seed, seed=seed)
        return set(zip(events.x.tolist(), events.y.tolist(), strict=True))

    assert len(hot(1, 1)) == round(2e-3 * 48 * 64)
    assert hot(1, 1) == hot(1, 2)
    assert hot(1, 1) != hot(2, 1)


@pytest.mark.parametrize("refr", [-20, 0, 60])
def test_a_hot_pixel_fires_as_soon_as_its_dead_time_ends_and_never_before(refr):
    noise = NoiseTruth(mismatch=0.0, background_hz=0.0, hot_share=4e-3, hot_hz=2e5, reset_noise=0.0)
    setting = PixelSettings.from_biases({"bias_refr": refr})
    events = simulate(picture(48, 64), LightState(output=False), 5e4, noise=noise, settings=setting)
    where = events.y.astype(int) * 64 + events.x
    waits = np.concatenate([np.diff(events.t[where == w]) for w in np.unique(where)])
    assert setting.dead_us - 1.01 <= waits.min() <= setting.dead_us + 2.0


def test_a_new_picture_fires_where_it_changed():
    sensor = Sensor(64, 48, noise=NOISE_LEVELS["none"])
    steady = LightState(low_v=5.0, high_v=5.0, output=True)
    sensor.begin(np.full((48, 64), 0.2, np.float32), steady, 0.0)
    assert len(sensor.run(2000).t) == 0
    changed = np.full((48, 64), 0.2, np.float32)
    changed[10, 20], changed[11, 21] = 0.9, 0.0
    sensor.change(changed, steady, 0.0, 2000.0)
    events = sensor.run(4000)
    assert set(zip(events.x, events.y, events.p, strict=True)) == {(20, 10, 1), (21, 11, 0)}


def test_switching_the_light_on_shows_the_picture():
    sensor = Sensor(64, 48, noise=NOISE_LEVELS["none"])
    sensor.begin(picture(48, 64), LightState(output=False), 0.0)
    assert len(sensor.run(5000).t) == 0
    sensor.change(None, SQUARE, 0.1, 2000.0)
    events = sensor.run(10_000)
    assert events.p.all()  # the dark is followed by light
    assert len(np.unique(events.y.astype(int) * 64 + events.x)) > 2000


def test_higher_thresholds_give_fewer_events():
    def count(on):
        setting = PixelSettings.from_biases({"bias_diff_on": on})
        events = simulate(picture(48, 64), SINE, 34_000, settings=setting)
        return np.count_nonzero(events.p)

    assert count(-60) > 1.3 * count(0) > 1.3 * 1.3 * count(100)


def test_a_sensor_that_sees_nothing_is_a_mistake():
    with pytest.raises(SimulationMisuse):
        Sensor(64, 48).run(100)
    with pytest.raises(SimulationMisuse, match="shape"):
        Sensor(64, 48).begin(np.zeros((10, 10), np.float32), SQUARE, 0.0)

"""The sensor: against an equation solved step by step, and against what every event sensor obeys."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.errors import SimulationMisuse
from simulators.pixels.biases import ALLOWED, PixelSettings
from simulators.pixels.sensor import Link, Sensor, simulate
from simulators.world.truth import NOISE_LEVELS, NoiseTruth
from simulators.world.world import LightState
from tests.unit.simulators.ode_pixel import solve_step_by_step, solve_with_filters

MISMATCH_ONLY = NoiseTruth(mismatch=0.12, background_hz=0.0, hot_share=0.0, hot_hz=0.0, reset_noise=0.0)
SQUARE = LightState(waveform="square", output=True)
SINE = LightState(waveform="sine", output=True)


def picture(height, width, seed=0):
    return np.random.default_rng(seed).random((height, width)).astype(np.float32)


def by_pixel(events, x, y):
    inside = (events.x == x) & (events.y == y)
    return events.t[inside], events.p[inside]


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


@pytest.mark.parametrize(("q_us", "row"), [(20.0, 16), (60.0, 31), (200.0, 115)])
def test_where_a_square_event_is_off_by_more_the_equation_itself_turns_on_millionths(q_us, row):
    # The worst 3 of 6267 events of 450 pixels. In the tail of an edge u is all but flat: float32's last digits,
    # 2e-6 of the light, move an event by microseconds, and the equation's by as much.
    scene, phase, period, duration = picture(150, 1, seed=int(q_us) + 1), 0.37, SQUARE.period_us, 33_400.0
    setting = PixelSettings(q_us=q_us)
    sensor = Sensor(1, 150, noise=MISMATCH_ONLY, settings=setting, camera_seed=3, link=Link.ideal())
    sensor.begin(scene, SQUARE, phase)
    found_t, _ = by_pixel(sensor.run(duration), 0, row)
    on, off = (threshold[row, 0] for threshold in sensor.thresholds)

    def by_equation(more):
        times, _ = solve_step_by_step(
            float(scene[row, 0]), period, phase * period, 0, SQUARE.low, SQUARE.high, 0.5, setting.ambient,
            q_us, on + more, off + more, setting.dead_us, -2 * period, duration,
        )  # fmt: skip
        return np.array([t for t in times if t >= 0.0]) - 0.5

    earlier, exact, later = (by_equation(more) for more in (-2e-6, 0.0, 2e-6))
    assert np.abs(found_t - exact).max() > 1.5
    assert (earlier - 1.5 <= found_t).all()
    assert (found_t <= later + 1.5).all()


@pytest.mark.parametrize(("follower_us", "corner_hz"), [(50.0, 0.0), (200.0, 0.0), (1.5, 20.0), (50.0, 60.0)])
def test_follower_and_high_pass_are_those_of_their_equations(follower_us, corner_hz):
    height, duration, phase = 8, 33_400.0, 0.37
    setting = PixelSettings(follower_us=follower_us, high_pass_hz=corner_hz)
    scene = picture(height, 1, seed=7)
    sensor = Sensor(1, height, noise=MISMATCH_ONLY, settings=setting, camera_seed=3, link=Link.ideal())
    sensor.begin(scene, SQUARE, phase)
    events = sensor.run(duration)
    on, off = sensor.thresholds
    period = SQUARE.period_us
    errors = []
    for y in range(height):
        times, polarities = solve_with_filters(
            float(scene[y, 0]), period, phase * period, SQUARE.low, SQUARE.high, 0.5, setting.ambient,
            setting.q_us, follower_us, 2e-6 * np.pi * corner_hz, on[y, 0], off[y, 0], setting.dead_us, duration,
        )  # fmt: skip
        expected = [(t, p) for t, p in zip(times, polarities, strict=True) if t >= 0.0]
        found_t, found_p = by_pixel(events, 0, y)
        assert list(found_p) == [p for _, p in expected]
        errors.append(np.abs(found_t + 0.5 - np.array([t for t, _ in expected])))
    found = np.concatenate(errors)
    assert len(found) > 40
    assert np.quantile(found, 0.95) <= 0.5 + 2.0  # in the flat tail of an edge, times answer to nothing
    assert np.median(found) <= 0.5


def test_a_slower_follower_delays_and_calms():
    def first_on(fo):
        setting = PixelSettings.from_biases({"bias_fo": fo})
        noise = NOISE_LEVELS["none"]
        events = simulate(np.ones((8, 32), np.float32), SQUARE, 10_000, noise=noise, settings=setting)
        return np.median(events.t[events.p == 1]), setting.background_gain

    assert first_on(-35)[0] > 5.0 * first_on(0)[0]
    assert first_on(-35)[1] < 0.5 * first_on(0)[1]
    assert first_on(20)[0] == first_on(0)[0]  # the photoreceptor's own pole is the slower one


def test_the_high_pass_forgets_an_edge():
    def off_share_while_bright(hpf):
        setting = PixelSettings.from_biases({"bias_hpf": hpf})
        events = simulate(
            np.ones((8, 32), np.float32), SQUARE, 8_000, noise=NOISE_LEVELS["none"], settings=setting
        )
        return np.count_nonzero(events.p == 0) / len(events.t)

    assert off_share_while_bright(0) == 0.0
    assert off_share_while_bright(110) > 0.3


def test_dead_pixels_never_fire_and_stay_with_the_camera():
    noise = replace(NOISE_LEVELS["heavy"], dead_share=0.05)

    def silent(camera_seed, seed):
        events = simulate(
            np.ones((48, 64), np.float32), SQUARE, 60_000, noise=noise, camera_seed=camera_seed, seed=seed
        )
        return set(range(48 * 64)) - set((events.y.astype(int) * 64 + events.x).tolist())

    assert len(silent(1, 1)) == round(0.05 * 48 * 64)
    assert silent(1, 1) == silent(1, 2)
    assert silent(1, 1) != silent(2, 1)


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

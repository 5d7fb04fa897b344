"""The sensor: compared with a differential equation solved in steps, and with laws that hold for every event sensor."""

from dataclasses import replace

import numpy as np
import pytest
from slow_cases import first_quick
from still_picture import simulate

from simulators.pixels.biases import ALLOWED, PixelSettings
from simulators.pixels.sensor import Link, Sensor
from simulators.world.truth import NOISE_LEVELS, NoiseTruth
from simulators.world.world import LightState
from tests.unit.simulators.pixels.ode_pixel import solve, solve_with_filters

MISMATCH_ONLY = NoiseTruth(mismatch=0.12, background_hz=0.0, hot_share=0.0, hot_hz=0.0, reset_noise=0.0)
SQUARE = LightState(waveform="square", output=True)


def picture(height, width, seed=0):
    return np.random.default_rng(seed).random((height, width)).astype(np.float32)


def by_pixel(events, x, y):
    inside = (events.x == x) & (events.y == y)
    return events.t[inside], events.p[inside]


def test_a_row_that_is_read_as_one_is_as_exact_in_the_tail_of_an_edge():
    # Pixels alike in a row ask and are read together: so many are worked on as a batch.
    alike, phase, duration, setting = 12, 0.37, 17_000.0, PixelSettings(q_us=200.0)
    scene = np.repeat(picture(600, 1, seed=8), alike, axis=1)
    noise = replace(MISMATCH_ONLY, mismatch=0.0)
    sensor = Sensor(alike, 600, noise=noise, settings=setting, link=Link.ideal())
    sensor.begin(scene, SQUARE, phase)
    events, (on, off) = sensor.run(duration), sensor.thresholds
    errors = []
    for y in range(600):
        times, polarities = solve(SQUARE, scene[y, 0], phase, setting, (on[y, 0], off[y, 0]), duration)
        found_t, found_p = by_pixel(events, 0, y)
        assert list(found_p) == list(polarities)
        errors.append(found_t + 0.5 - times)
        assert np.count_nonzero(events.y == y) == alike * len(times)
    assert np.abs(np.concatenate(errors)).max() <= 0.5 + 1.0


@pytest.mark.parametrize(
    ("follower_us", "corner_hz"), first_quick([(50.0, 60.0), (50.0, 0.0), (200.0, 0.0), (1.5, 20.0)])
)
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
    all_errors = np.concatenate(errors)
    assert len(all_errors) > 40
    assert np.quantile(all_errors, 0.95) <= 0.5 + 2.0  # in the flat tail of an edge, times answer to nothing
    assert np.median(all_errors) <= 0.5


@pytest.mark.parametrize(
    ("bias", "setting", "rises"),
    [
        ("bias_diff_on", "threshold_on", True),
        ("bias_diff_off", "threshold_off", True),
        ("bias_fo", "follower_us", False),
        ("bias_hpf", "high_pass_hz", True),
        ("bias_refr", "dead_us", False),
    ],
)
def test_a_bias_works_the_way_the_maker_says_over_all_of_its_range(bias, setting, rises):
    low, high = ALLOWED[bias]
    steps = np.diff([getattr(PixelSettings.from_biases({bias: v}), setting) for v in range(low, high + 1)])
    assert ((steps > 0) == rises)[steps != 0].all()
    assert np.count_nonzero(steps) >= 35


def test_a_slower_follower_delays_and_calms():
    def first_on(fo):
        setting = PixelSettings.from_biases({"bias_fo": fo})
        noise = NOISE_LEVELS["none"]
        events = simulate(np.ones((8, 32), np.float32), SQUARE, 10_000, noise=noise, settings=setting)
        return np.median(events.t[events.p == 1]), setting.background_gain

    assert first_on(-35)[0] > 5.0 * first_on(0)[0]
    assert first_on(-35)[1] < 0.5 * first_on(0)[1]
    assert first_on(20)[0] == first_on(0)[0]  # the photoreceptor's own pole is the slower one


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

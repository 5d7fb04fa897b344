"""Tails of squares: when a pixel that was reset crosses a threshold next."""

import numpy as np
import pytest
from inner_loops import from_python

from simulators.pixels import pixel_reset
from simulators.pixels.pixel_noise import reset_error as inner_reset_error
from simulators.pixels.sensor import Sensor
from simulators.pixels.sensor_state import EPOCH, FREE, GAINS, STORED_LIGHT
from simulators.world.truth import NoiseTruth
from simulators.world.world import LightState

reset_error = from_python(inner_reset_error)

level, crossing = from_python(pixel_reset.level), from_python(pixel_reset.crossing)

limit_distance, tail_width = from_python(pixel_reset.limit_distance), from_python(pixel_reset.tail_width)

join_digits, lower_digits = from_python(pixel_reset.join_digits), from_python(pixel_reset.lower_digits)

SQUARE = LightState(waveform="square", output=True)


@pytest.mark.parametrize("width", [4, 640])  # reset pixel by pixel, and as a whole row
@pytest.mark.parametrize("reset_noise", [0.0, 0.01])
def test_a_reset_finds_the_next_crossing_to_a_tenth_of_a_microsecond(width, reset_noise, monkeypatch):
    noise = NoiseTruth(mismatch=0.0, background_hz=0.0, hot_share=0.0, hot_hz=0.0, reset_noise=reset_noise)
    sensor = Sensor(width, 640 // width, noise=noise)
    # Lights that just reach an ON threshold of 25 % from the dark, and some that do not.
    scene = np.linspace(0.02776, 0.0278, 640, dtype=np.float32).reshape(-1, width)
    given, start_pixels = [], pixel_reset.start_pixels
    monkeypatch.setattr(pixel_reset, "start_pixels", lambda *of: given.append(of) or start_pixels(*of))
    sensor.begin(scene, SQUARE, 0.0)
    ((px, drive, ro, _, state, random),) = given
    worst, flat = 0.0, 0
    for t in np.linspace(100.0, drive.period_us - 100.0, 8):
        drawn = random.copy()
        state[FREE], state[EPOCH] = t + ro.dead_us, 0.0
        start_pixels(px, drive, ro, width, state, random)
        phase = (t + ro.dead_us) % drive.period_us
        for at in np.ndindex(scene.shape):
            gains, light, found = px.gains[at][GAINS], float(px.cell[at][STORED_LIGHT]), px.t_next[at]
            u = level(drive, light, phase) * reset_error(ro.normals, ro.reset_noise, drawn)
            levels = u * (gains & 0xFFFF) / 65536.0, u / ((gains >> 16) / 65536.0)
            cross, on = crossing(drive, light, *levels, phase)
            assert np.isfinite(cross) == np.isfinite(found)
            if np.isfinite(cross):
                assert px.is_on[at] & 1 == on
                worst = max(worst, abs(t + ro.dead_us - phase + cross - found))
                flat += limit_distance(drive, light, *levels) < tail_width(drive)
    assert worst < 0.1
    assert flat > 100


def test_a_reference_and_its_lower_digits_make_nine_digits():
    for u in np.random.default_rng(1).uniform(0.1, 10.0, 1000):
        u32 = np.float32(u)
        assert join_digits(u32, lower_digits(u, u32)) == pytest.approx(u, rel=6e-10, abs=0.0)
        assert join_digits(u32, np.uint8(1)) == u32  # only its polarity stands beside it

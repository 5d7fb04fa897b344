"""Crossings in the flat tail of an edge: computed in float32, singly or as a batch, and corrected in double precision."""

import numpy as np
import pytest
from inner_loops import from_python

from simulators.pixels import pixel_reset
from simulators.pixels import square_tail as tail
from simulators.pixels.pixel_noise import reset_error as inner_reset_error
from simulators.pixels.pixel_reset import reset_row as inner_reset_row
from simulators.pixels.sensor import Sensor
from simulators.pixels.sensor_state import GAINS, STORED_LIGHT
from simulators.world.truth import NoiseTruth
from simulators.world.world import LightState

reset_row, reset_error = from_python(inner_reset_row), from_python(inner_reset_error)
level, crossing = from_python(tail.level), from_python(tail.crossing)
limit_distance, tail_width = from_python(tail.limit_distance), from_python(tail.tail_width)
join_digits, lower_digits = from_python(tail.join_digits), from_python(tail.lower_digits)

SQUARE = LightState(waveform="square", output=True)
WIDTH = 640


@pytest.mark.parametrize("together", [4, WIDTH])
@pytest.mark.parametrize("reset_noise", [0.0, 0.01])
def test_a_reset_finds_the_next_crossing_to_a_tenth_of_a_microsecond(together, reset_noise, monkeypatch):
    noise = NoiseTruth(mismatch=0.0, background_hz=0.0, hot_share=0.0, hot_hz=0.0, reset_noise=reset_noise)
    sensor = Sensor(WIDTH, 1, noise=noise)
    # Lights that just reach an ON threshold of 25 % from the dark, and some that do not.
    scene = np.linspace(0.02776, 0.0278, WIDTH, dtype=np.float32)[None]
    given, start_pixels = [], pixel_reset.start_pixels
    monkeypatch.setattr(
        pixel_reset, "start_pixels", lambda *parts: given.append(parts) or start_pixels(*parts)
    )
    sensor.begin(scene, SQUARE, 0.0)
    ((px, drive, ro, _, _, random),) = given
    gains = px.gains[0, :, GAINS]
    on_gain, off_gain = (gains & 0xFFFF) / 65536.0, (gains >> 16) / 65536.0
    worst, flat = 0.0, 0
    for t in np.linspace(100.0, drive.period_us - 100.0, 24):
        for first in range(0, WIDTH, together):
            px.column[:together] = np.arange(first, first + together)
            drawn = random.copy()
            reset_row(px, drive, ro, 0, together, t, 0.0, random)
            phase = (t + ro.dead_us) % drive.period_us
            for c in range(first, first + together):
                light = float(px.cell[0, c, STORED_LIGHT])
                u = level(drive, light, phase) * reset_error(ro.normals, ro.reset_noise, drawn)
                cross, on = crossing(drive, light, u * on_gain[c], u / off_gain[c], phase)
                expected = t + ro.dead_us - phase + cross
                assert np.isfinite(cross) == np.isfinite(px.t_next[0, c])
                if np.isfinite(cross):
                    assert px.is_on[0, c] & 1 == on
                    worst = max(worst, abs(expected - px.t_next[0, c]))
                    flat += limit_distance(drive, light, u * on_gain[c], u / off_gain[c]) < tail_width(drive)
    assert worst < 0.1
    assert flat > 100


def test_a_reference_and_its_lower_digits_make_nine_digits():
    for u in np.random.default_rng(1).uniform(0.1, 10.0, 1000):
        u32 = np.float32(u)
        assert join_digits(u32, lower_digits(u, u32)) == pytest.approx(u, rel=6e-10, abs=0.0)
        assert join_digits(u32, np.uint8(1)) == u32  # only its polarity stands beside it

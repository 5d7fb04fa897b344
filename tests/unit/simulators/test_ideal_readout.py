"""Events of an ideal readout: compared with a differential equation solved in steps, and sorted."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ideal_readout import EVENT, WARM_UP, ideal_events, ideal_slices

from simulators.errors import SimulationMisuse
from simulators.pixels.biases import PixelSettings
from simulators.world.world import LightState
from tests.unit.simulators.ode_pixel import solve_step_by_step

SINE = LightState(waveform="sine", output=True)


def picture(height, width, seed=0):
    return np.random.default_rng(seed).random((height, width)).astype(np.float32)


def after_dark(light, phase):
    """Time shortly after the darkest level some periods before 0, where the pixels' references begin."""
    return light.period_us * (0.8 - phase - WARM_UP - 2)


@pytest.mark.parametrize("q_us", [20.0, 60.0, 200.0])
def test_ideal_events_are_those_of_the_differential_equation(q_us):
    pixels, duration, phase = 4, 33_400.0, 0.37
    scene = picture(pixels, 1, seed=int(q_us))
    setting = PixelSettings(q_us=q_us)
    rng = np.random.default_rng(4)
    thresholds = (rng.uniform(0.15, 0.35, (pixels, 1)), rng.uniform(0.15, 0.35, (pixels, 1)))
    events = ideal_events(scene, SINE, duration, phase=phase, settings=setting, thresholds=thresholds)
    compared, errors = 0, []
    for y in range(pixels):
        times, polarities = solve_step_by_step(
            float(scene[y, 0]), SINE.period_us, phase * SINE.period_us, 1, SINE.low, SINE.high, 0.5,
            setting.ambient, q_us, thresholds[0][y, 0], thresholds[1][y, 0], 0.0,
            after_dark(SINE, phase), duration,
        )  # fmt: skip
        expected = [(t, p) for t, p in zip(times, polarities, strict=True) if t >= 0.0]
        found = events[events["y"] == y]
        assert found["p"].tolist() == [p for _, p in expected]
        errors.append(found["t"] + 0.5 - np.array([t for t, _ in expected]))
        compared += len(expected)
    assert compared > 50
    assert np.abs(np.concatenate(errors)).max() <= 0.5 + 2.0


@given(seed=st.integers(0, 1000), frequency=st.floats(20, 500), phase=st.floats(0, 1, exclude_max=True))
@settings(max_examples=15, deadline=None)
def test_they_are_sorted_complete_and_inside(seed, frequency, phase):
    light = LightState(waveform="sine", frequency_hz=frequency, output=True)
    duration = 2.2 * light.period_us
    events = ideal_events(picture(12, 16, seed), light, duration, phase=phase)
    assert (np.diff(events["t"]) >= 0).all()
    assert events["t"].min() >= 0
    assert events["t"].max() < duration
    assert events["x"].max() < 16
    assert events["y"].max() < 12
    parts = [part.copy() for part in ideal_slices(picture(12, 16, seed), light, duration, phase=phase)]
    np.testing.assert_array_equal(np.concatenate(parts), events)
    longer = ideal_events(picture(12, 16, seed), light, 2 * duration, phase=phase)
    np.testing.assert_array_equal(longer[longer["t"] < duration // 1], events[events["t"] < duration // 1])


def test_an_event_has_the_16_bytes_that_readers_of_metavision_know():
    assert EVENT.itemsize == 16
    assert [EVENT.fields[name][1] for name in ("x", "y", "p", "t")] == [0, 2, 4, 8]


@pytest.mark.parametrize("light", [LightState(waveform="square", output=True), LightState(output=False)])
def test_a_light_without_slopes_is_refused(light):
    with pytest.raises(SimulationMisuse, match="smoothly"):
        next(ideal_slices(picture(4, 4), light, 1000.0))

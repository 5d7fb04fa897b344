"""Flicker from triggers and from events: what is recovered, what is refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.errors import FlickerNotFound, TooFewEvents
from calib.events.flicker import flicker_from_events, flicker_from_triggers


def edges(period, phase, n, *, duty=0.5, jitter=0.0, seed=0):
    """Return times and values of n whole periods of edges, in order."""
    rng = np.random.default_rng(seed)
    k = np.arange(n)
    t = np.concatenate([phase + k * period, phase + (k + duty) * period]) + jitter * rng.standard_normal(
        2 * n
    )
    value = np.concatenate([np.ones(n, np.uint8), np.zeros(n, np.uint8)])
    order = np.argsort(t)
    return np.round(t[order]).astype(np.int64), value[order]


def bursts(period, phase, n, *, duty=0.5, events=400, spread=300.0, background=0, seed=0):
    """Return event times and polarities: a burst of ON after each rising edge, of OFF after each falling one."""
    rng = np.random.default_rng(seed)
    t, p = [], []
    for k in range(n):
        for share, polarity in ((0.0, 1), (duty, 0)):
            t.append(phase + (k + share) * period + rng.exponential(spread, events))
            p.append(np.full(events, polarity))
    t.append(rng.uniform(phase, phase + n * period, background))
    p.append(rng.integers(0, 2, background))
    t, p = np.concatenate(t), np.concatenate(p)
    order = np.argsort(t)
    return t[order].astype(np.int64), p[order]


@given(frequency=st.floats(15, 900), phase=st.floats(0, 1e7), n=st.integers(3, 600), duty=st.floats(0.2, 0.8))
@settings(max_examples=60, deadline=None)
def test_a_clean_train_gives_its_period_phase_and_duty(frequency, phase, n, duty):
    period = 1e6 / frequency
    flicker = flicker_from_triggers(*edges(period, phase, n, duty=duty))
    assert flicker.period_us == pytest.approx(period, abs=1.6 / n)  # edges are whole microseconds
    assert flicker.phase_us == pytest.approx(phase, abs=1.0)
    assert flicker.duty == pytest.approx(duty, abs=2.0 / period)
    assert flicker.missing == 0


def test_jitter_is_measured_and_the_phase_is_that_of_all_edges():
    t, value = edges(16667, 1000, 400, jitter=20, seed=1)
    t[0] = 1045  # the first edge alone would give a phase 45 us late
    flicker = flicker_from_triggers(t, value)
    assert flicker.jitter_us == pytest.approx(20, rel=0.1)
    assert flicker.phase_us == pytest.approx(1000, abs=4)


@pytest.mark.parametrize(
    ("left_out", "added", "missing"),
    [
        ([6, 20, 21, 22], [], 3),  # rising 3, 10 and 11; falling 10
        ([], [9000, 200_000], 0),  # they fit no period
        ([], [5000 + 2 * 16667 + 30], 0),  # a bounce right after an edge
    ],
    ids=["missing", "stray", "bounce"],
)
def test_edges_that_are_missing_are_counted_and_those_that_do_not_fit_are_left_out(left_out, added, missing):
    t, value = (np.delete(each, left_out) for each in edges(16667, 5000, 30))
    t, value = np.append(t, added).astype(np.int64), np.append(value, np.ones(len(added), np.uint8))
    order = np.argsort(t)
    flicker = flicker_from_triggers(t[order], value[order])
    assert flicker.period_us == pytest.approx(16667, abs=0.1)
    assert flicker.phase_us == pytest.approx(5000, abs=1)
    assert flicker.missing == missing
    assert flicker.jitter_us < 1


def test_the_papers_33_ms_may_hold_one_rising_and_two_falling_edges():
    flicker = flicker_from_triggers(np.array([300, 8633, 16967]), np.array([0, 1, 0]))
    assert flicker.period_us == pytest.approx(16667)
    assert flicker.phase_us == pytest.approx(8633)
    assert np.isnan(flicker.jitter_us)


def test_one_edge_is_enough_where_the_frequency_is_known():
    flicker = flicker_from_triggers(np.array([8633]), np.array([1]), expected_hz=60)
    assert flicker.period_us == pytest.approx(1e6 / 60)
    assert np.isnan(flicker.duty)


@pytest.mark.parametrize(
    ("t", "value"),
    [([], []), ([100], [1]), ([100, 8000], [1, 0]), ([0, 900, 7000, 7100, 11_300, 30_000], [1] * 6)],
)
def test_edges_without_a_period_are_refused(t, value):
    with pytest.raises(FlickerNotFound, match="trigger edges"):
        flicker_from_triggers(np.array(t, np.int64), np.array(value, np.uint8))


def test_a_train_of_another_frequency_than_the_lights_is_refused():
    with pytest.raises(FlickerNotFound, match=r"50\.000 Hz, .* 60"):
        flicker_from_triggers(*edges(20_000, 0, 10), expected_hz=60)


@pytest.mark.parametrize("duty", [0.1, 0.5, 0.7])
@pytest.mark.parametrize("frequency", [20, 60, 333])
def test_events_alone_give_period_and_phase(frequency, duty):
    period = 1e6 / frequency
    spread = min(300.0, period / 40)
    n = max(3, int(frequency * 0.1))
    flicker = flicker_from_events(*bursts(period, 4321, n, duty=duty, spread=spread, background=2000))
    assert flicker.source == "events"
    assert flicker.period_us == pytest.approx(period, rel=2e-3)
    late = (flicker.phase_us - 4321 + period / 2) % period - period / 2
    assert abs(late) < 0.02 * period
    assert flicker.duty == pytest.approx(duty, abs=0.02)


@pytest.mark.parametrize("frequency", [50, 60])
@pytest.mark.parametrize("width_us", [500, 2000, 4000])
def test_a_burst_that_the_recording_cuts_does_not_shift_the_period(frequency, width_us):
    period = 1e6 / frequency
    t = np.concatenate([k / 2 * period + np.linspace(0, width_us, 3000) for k in range(10)])
    p = np.repeat(np.arange(1, 11) % 2, 3000)
    order = np.argsort(t)
    t, p = t[order].astype(np.int64), p[order]
    for start_us in np.arange(0, 1, 0.05) * period:
        recorded = slice(*np.searchsorted(t, [start_us, start_us + 51e3]))
        assert flicker_from_events(t[recorded], p[recorded]).frequency_hz == pytest.approx(
            frequency, rel=5e-4
        )


def test_a_sine_is_not_taken_for_its_harmonics():
    rng = np.random.default_rng(3)
    t = rng.uniform(0, 100_000, 60_000)
    rate = np.cos(2 * np.pi * t / 16667)
    keep = rng.uniform(size=t.size) < np.abs(rate)
    order = np.argsort(t[keep])
    flicker = flicker_from_events(t[keep][order].astype(np.int64), (rate[keep][order] > 0).astype(np.uint8))
    assert flicker.period_us == pytest.approx(16667, rel=5e-3)


def test_background_without_flicker_is_refused():
    rng = np.random.default_rng(4)
    t = np.sort(rng.integers(0, 200_000, 50_000))
    with pytest.raises(FlickerNotFound, match="No period stands out"):
        flicker_from_events(t, rng.integers(0, 2, t.size))


def test_less_than_two_periods_are_refused():
    with pytest.raises(FlickerNotFound):
        flicker_from_events(*bursts(16667, 0, 1), band_hz=(40, 80))


def test_a_handful_of_events_is_refused():
    with pytest.raises(TooFewEvents):
        flicker_from_events(np.arange(5), np.ones(5))

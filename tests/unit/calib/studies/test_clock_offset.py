"""Offset and rate of two clocks by edges of one signal: against the truth of drawn signals, with edges missing."""

import time

import numpy as np
import pytest

from calib.errors import InputMismatch
from calib.studies.clock_offset import clock_offset, common_rate

RATE = 41e-6


def drawn(seed, intervals, offset_us, *, rate=RATE, missed=0.01, jitter_us=0.5):
    """Edge times of one signal by two clocks, some edges missed by each, and the truth as a function."""
    rng = np.random.default_rng(seed)
    t = rng.uniform(0, 5000) + np.cumsum(intervals)
    middle = t.mean()
    both = t, t + offset_us + rate * (t - middle)
    late = ((times + jitter_us * rng.standard_normal(len(t)), rng.random(len(t))) for times in both)
    seen = [np.floor(times)[drawn > missed] for times, drawn in late]
    return seen[0][seed % 40 :], seen[1][: -(seed % 30) or None], lambda at: offset_us + rate * (at - middle)


def pattern(seed, n=600):
    return np.random.default_rng([7, seed]).choice([3000.0, 4000.0, 5500.0], n)


def test_a_pattern_gives_the_offset_within_its_uncertainty_however_large_it_is():
    off, slope = [], []
    for seed in range(30):
        offset = np.random.default_rng([8, seed]).uniform(-1e5, 1e8)
        first, second, truth = drawn(seed, pattern(seed), offset)
        clock = clock_offset("a", first, second)
        assert clock.period_us is None
        assert clock.sigma_us < 1.0
        off.append((clock.offset_us - truth(clock.at_us)) / clock.sigma_us)
        slope.append((clock.rate_ppm - 1e6 * RATE) / clock.sigma_rate_ppm)
    assert np.sqrt(np.mean(np.square(off))) < 1.2
    assert np.abs(slope).max() < 3.0


@pytest.mark.parametrize("n", [12, 300, 3000])
def test_a_periodic_signal_gives_the_offset_up_to_whole_periods(n):
    first, second, truth = drawn(3, np.full(n, 4000.0), 1234.5)
    clock = clock_offset("a", first, second)
    assert clock.period_us == pytest.approx(4000.0 * (1 + RATE), abs=1.0)
    assert clock.offset_us == pytest.approx(truth(clock.at_us), abs=4.0 * clock.sigma_us)
    later = clock_offset("a", first, second + 20_000.0)
    assert later.offset_us == pytest.approx(clock.offset_us, abs=2.0)


def test_rates_of_all_recordings_are_one_rate():
    clocks = [clock_offset(str(seed), *drawn(seed, pattern(seed), 50.0)[:2]) for seed in range(5)]
    rate, sigma = common_rate(clocks)
    assert abs(rate - 1e6 * RATE) < 3.0 * sigma
    assert sigma < min(clock.sigma_rate_ppm for clock in clocks)


def test_edges_that_agree_to_the_microsecond_are_no_better_known_than_its_half():
    edges = np.cumsum(pattern(1))
    clock = clock_offset("a", edges, edges + 500.0)
    assert clock.offset_us == pytest.approx(500.0)
    assert clock.sigma_us == pytest.approx(np.sqrt(2.0 / 12.0))
    assert clock.sigma_rate_ppm == pytest.approx(2e6 / np.sqrt(12.0) / np.ptp(edges))


def test_many_edges_without_a_common_signal_are_refused_in_seconds():
    begun = time.process_time()
    with pytest.raises(InputMismatch):
        clock_offset("a", np.arange(200_000) * 100, np.arange(200_000) * 100.04)
    assert time.process_time() - begun < 10.0


@pytest.mark.parametrize(
    ("first", "second", "fault"),
    [
        (np.arange(100) * 4000, np.arange(100) * 5000, "4000 us apart, the second 100, 5000 us apart"),
        (np.arange(100) * 4000, np.arange(300) * 4004, "do not belong together"),
        (np.cumsum(pattern(1)), np.cumsum(pattern(2)), "do not belong together"),
        (np.cumsum(pattern(1))[:200], np.cumsum(pattern(1))[300:], "do not belong together"),
        (np.arange(4), np.arange(100), "At pose, a camera recorded 4 rising sync edges"),
        ([], [], "recorded 0 rising"),
    ],
)
def test_recordings_without_a_common_signal_are_refused(first, second, fault):
    with pytest.raises(InputMismatch, match=fault):
        clock_offset("pose", first, second)

"""Drift: slopes and between-run scatter against another program, and the level and power of the test."""

import numpy as np
import pytest

from bench.history.statistics import find_drift, holm

NO_WARMTH = [None] * 400


def test_another_program_finds_the_same_slope_and_uncertainty():
    api = pytest.importorskip("statsmodels.api")
    rng = np.random.default_rng(1)
    days, u = np.arange(30.0), rng.uniform(1.5, 4.5, 30)
    y = 3345.0 + 0.2 * days + rng.normal(0, 0.5 * u)  # scatters less than stated: tau is 0
    found = find_drift(days, NO_WARMTH[:30], y, u)
    fit = api.WLS(y, api.add_constant(days), weights=1 / u**2).fit()
    assert found.between_runs == 0.0
    assert (found.per_day.value, found.per_day.sigma) == pytest.approx((fit.params[1], fit.bse[1]))
    assert found.per_day.p == pytest.approx(fit.pvalues[1])


def test_another_program_finds_the_same_scatter_between_runs():
    analysis = pytest.importorskip("statsmodels.stats.meta_analysis")
    rng = np.random.default_rng(2)
    u = rng.uniform(0.5, 1.5, 4)
    y = rng.normal(0, 3.0, 4)
    # With fewer than five runs there is no fit, so the mean alone is compared, with more runs and no slope.
    u, y = np.tile(u, 5), np.concatenate([y + n for n in rng.normal(0, 2.0, 5)])
    found = find_drift([0.0] * 20, NO_WARMTH[:20], y, u)
    combined = analysis.combine_effects(y, u**2, method_re="iterated")
    assert found.between_runs**2 == pytest.approx(combined.tau2, rel=1e-4)
    assert found.per_day is None


def test_both_slopes_are_found_together_and_told_apart():
    rng = np.random.default_rng(3)
    days, warm = np.arange(60.0), 40 + rng.normal(0, 1.0, 60)
    y = 3345 + 0.05 * days - 0.8 * warm + rng.normal(0, 0.5, 60)
    found = find_drift(days, list(warm), y, np.full(60, 0.5))
    assert found.joint
    assert found.per_day.value == pytest.approx(0.05, abs=4 * found.per_day.sigma)
    assert found.per_c.value == pytest.approx(-0.8, abs=4 * found.per_c.sigma)
    assert max(found.per_day.p, found.per_c.p) < 1e-6


def test_a_warm_up_is_not_separated_from_time():
    days = np.arange(20.0)
    found = find_drift(days, list(40 + 0.1 * days), 3345 + 0.3 * days, np.ones(20))
    assert not found.separable
    assert not found.joint
    assert found.per_day.p < 0.001
    assert found.per_c.p < 0.001


def test_runs_without_a_temperature_are_left_out_of_that_test_only():
    rng = np.random.default_rng(4)
    warm = [None if n % 3 == 0 else 40 + float(rng.normal()) for n in range(30)]
    found = find_drift(np.arange(30.0), warm, rng.normal(0, 1, 30), np.ones(30))
    assert (found.per_day.runs, found.per_c.runs, found.joint) == (30, 20, False)


@pytest.mark.parametrize(
    ("days", "warm"),
    [([0.0, 1, 2, 3], [None] * 4), ([1.0] * 9, [40.0] * 9), ([1.0] * 9, [40.0, 40.1] * 4 + [40.0])],
)
def test_without_runs_or_without_change_there_is_no_slope(days, warm):
    found = find_drift(days, warm, [3345.0] * len(days), [1.0] * len(days))
    assert (found.per_day, found.per_c) == (None, None)


def test_values_on_a_line_and_values_without_any_scatter():
    exact = find_drift(np.arange(9.0), NO_WARMTH[:9], 5 + 2 * np.arange(9.0), np.ones(9))
    assert exact.per_day.value == pytest.approx(2.0)
    still = find_drift(np.arange(9.0), NO_WARMTH[:9], np.full(9, 5.0), np.ones(9))
    assert still.per_day.value == pytest.approx(0.0, abs=1e-12)
    assert still.per_day.p > 0.05


@pytest.mark.parametrize(("between", "common"), [(0.0, 0.0), (1.0, 0.0), (0.0, 3.0)])
def test_the_level_of_the_test_is_right_whatever_the_runs_state(between, common):
    """Also if runs scatter more than stated, or less because an error is common to all."""
    rng, trials, n = np.random.default_rng(5), 600, 12
    false = 0
    for _ in range(trials):
        u = rng.uniform(0.7, 1.3, n)
        y = rng.normal(0, u) + rng.normal(0, between, n)
        false += find_drift(np.arange(12.0), NO_WARMTH[:n], y, np.hypot(u, common)).per_day.p < 0.05
    assert 0.02 < false / trials < 0.085  # 5 % within 3.5 standard deviations


def test_holm_keeps_the_order_and_never_lowers_a_chance():
    chances = [0.2, 0.001, 0.04, 0.6]
    adjusted = holm(chances)
    assert adjusted == pytest.approx([0.4, 0.004, 0.12, 0.6])
    assert holm([]) == []

"""Control limits and drift against published examples and theory."""

import numpy as np
import pytest

from bench.charts.statistics import D2, ewma, find_drift, holm, individuals

# ---------------------------------------------------------------- limits

VISCOSITY = (
    33.75, 33.05, 34.00, 33.81, 33.46, 34.02, 33.68, 33.27, 33.49, 33.20, 33.62, 33.00, 33.54, 33.12, 33.84,
)  # fmt: skip

"""Viscosity of a primer paint: an example of Montgomery's book on individuals, also in the R package qcc."""


def test_the_limits_of_a_published_example():
    chart = individuals(VISCOSITY)
    assert (round(chart["centre"], 2), round(D2 * chart["sigma"], 2)) == (33.52, 0.48)
    # The book computes with the rounded mean, range and constants.
    assert (chart["lower"], chart["upper"]) == pytest.approx((32.24, 34.80), abs=0.006)
    assert chart["beyond"] == ()


def test_a_baseline_alone_makes_the_limits():
    chart = individuals([*VISCOSITY, 36.0, 36.1], baseline=15)
    assert chart["upper"] == individuals(VISCOSITY)["upper"]
    assert chart["beyond"] == (15, 16)
    assert individuals([1.0, 2.0], baseline=9)["baseline"] == 2


def test_values_that_do_not_vary_are_in_control_and_a_change_is_not():
    chart = individuals([3345.1] * 10)
    assert (chart["beyond"], chart["sigma"]) == ((), 0.0)
    assert ewma([3345.1] * 10, chart["centre"], chart["sigma"])["beyond"] == ()
    assert individuals([3345.1] * 10 + [3345.2], baseline=10)["beyond"] == (10,)


def test_the_limits_of_the_average_follow_from_the_weights_of_its_values():
    chart = ewma(VISCOSITY, 33.5, 0.4, weight=0.2, limit=3.0)
    for last in range(len(VISCOSITY)):
        weights = 0.2 * 0.8 ** np.arange(last, -1.0, -1.0)
        assert chart["values"][last] == pytest.approx(
            33.5 + weights @ (np.array(VISCOSITY[: last + 1]) - 33.5)
        )
        half = 3.0 * 0.4 * np.linalg.norm(weights)
        assert (chart["lower"][last], chart["upper"][last]) == pytest.approx((33.5 - half, 33.5 + half))


# ---------------------------------------------------------------- drift

NO_WARMTH = [None] * 400


def test_a_slope_is_that_of_a_line_with_the_stated_weights():
    rng = np.random.default_rng(1)
    days, u = np.arange(30.0), rng.uniform(1.5, 4.5, 30)
    y = 3345.0 + 0.2 * days + rng.normal(0, 0.5 * u)  # scatters less than stated
    drift = find_drift(days, NO_WARMTH[:30], y, u)
    line, covariance = np.polyfit(days, y, 1, w=1 / u, cov=True)
    assert (drift.per_day["value"], drift.per_day["sigma"]) == pytest.approx(
        (line[0], covariance[0, 0] ** 0.5)
    )
    residuals = (y - np.polyval(line, days)) / u
    assert (drift.between_runs, drift.scatter) == (0.0, pytest.approx((residuals @ residuals / 28) ** 0.5))


def test_the_scatter_between_runs_is_what_the_stated_uncertainties_do_not_explain():
    rng = np.random.default_rng(2)
    u = rng.uniform(0.5, 1.5, 20)
    y = rng.normal(0, 3.0, 20)
    drift = find_drift([0.0] * 20, NO_WARMTH[:20], y, u)
    weights = 1 / (u**2 + drift.between_runs**2)
    assert weights @ (y - np.average(y, weights=weights)) ** 2 == pytest.approx(19)
    assert drift.per_day is None


def test_both_slopes_are_found_together_and_told_apart():
    rng = np.random.default_rng(3)
    days, warm = np.arange(60.0), 40 + rng.normal(0, 1.0, 60)
    y = 3345 + 0.05 * days - 0.8 * warm + rng.normal(0, 0.5, 60)
    drift = find_drift(days, list(warm), y, np.full(60, 0.5))
    assert drift.joint
    assert drift.per_day["value"] == pytest.approx(0.05, abs=4 * drift.per_day["sigma"])
    assert drift.per_c["value"] == pytest.approx(-0.8, abs=4 * drift.per_c["sigma"])
    assert max(drift.per_day["p"], drift.per_c["p"]) < 1e-6


def test_a_warm_up_is_not_separated_from_time():
    days = np.arange(20.0)
    drift = find_drift(days, list(40 + 0.1 * days), 3345 + 0.3 * days, np.ones(20))
    assert not drift.separable
    assert not drift.joint
    assert drift.per_day["p"] < 0.001
    assert drift.per_c["p"] < 0.001


def test_runs_without_a_temperature_are_left_out_of_that_test_only():
    rng = np.random.default_rng(4)
    warm = [None if n % 3 == 0 else 40 + float(rng.normal()) for n in range(30)]
    drift = find_drift(np.arange(30.0), warm, rng.normal(0, 1, 30), np.ones(30))
    assert (drift.per_day["runs"], drift.per_c["runs"], drift.joint) == (30, 20, False)


@pytest.mark.parametrize(
    ("days", "warm"),
    [([0.0, 1, 2, 3], [None] * 4), ([1.0] * 9, [40.0] * 9), ([1.0] * 9, [40.0, 40.1] * 4 + [40.0])],
)
def test_without_runs_or_without_change_there_is_no_slope(days, warm):
    drift = find_drift(days, warm, [3345.0] * len(days), [1.0] * len(days))
    assert (drift.per_day, drift.per_c) == (None, None)


def test_values_on_a_line_and_values_without_any_scatter():
    exact = find_drift(np.arange(9.0), NO_WARMTH[:9], 5 + 2 * np.arange(9.0), np.ones(9))
    assert exact.per_day["value"] == pytest.approx(2.0)
    still = find_drift(np.arange(9.0), NO_WARMTH[:9], np.full(9, 5.0), np.ones(9))
    assert still.per_day["value"] == pytest.approx(0.0, abs=1e-12)
    assert still.per_day["p"] > 0.05


@pytest.mark.parametrize(("between", "common"), [(0.0, 0.0), (1.0, 0.0), (0.0, 3.0)])
def test_the_level_of_the_test_is_right_whatever_the_runs_state(between, common):
    """Also if runs scatter more than stated, or less because an error is common to all."""
    rng, trials, n = np.random.default_rng(5), 600, 12
    false = 0
    for _ in range(trials):
        u = rng.uniform(0.7, 1.3, n)
        y = rng.normal(0, u) + rng.normal(0, between, n)
        false += find_drift(np.arange(12.0), NO_WARMTH[:n], y, np.hypot(u, common)).per_day["p"] < 0.05
    assert 0.02 < false / trials < 0.085  # 5 % within 3.5 standard deviations


def test_holm_keeps_the_order_and_never_lowers_a_chance():
    chances = [0.2, 0.001, 0.04, 0.6]
    adjusted = holm(chances)
    assert adjusted == pytest.approx([0.4, 0.004, 0.12, 0.6])
    assert holm([]) == []

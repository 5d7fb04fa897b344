"""Control limits and drift against published examples, another program, and theory."""

import math

import numpy as np
import pytest

from bench.charts.statistics import (
    D2,
    E2,
    EWMA_LIMIT,
    EWMA_WEIGHT,
    ewma,
    ewma_sigma,
    find_drift,
    holm,
    individuals,
)

# ---------------------------------------------------------------- limits

VISCOSITY = (
    33.75, 33.05, 34.00, 33.81, 33.46, 34.02, 33.68, 33.27, 33.49, 33.20, 33.62, 33.00, 33.54, 33.12, 33.84,
)  # fmt: skip

"""Viscosity of a primer paint: an example of Montgomery's book on individuals, also in the R package qcc."""


def test_the_constants_round_to_the_published_ones():
    assert (round(D2, 3), round(E2, 3)) == (1.128, 2.659)  # tables: 1.128, 3 / 1.128 = 2.660
    assert pytest.approx(3 / 1.128, rel=5e-4) == E2


def test_the_limits_of_a_published_example():
    chart = individuals(VISCOSITY)
    assert (round(chart["centre"], 2), round(D2 * chart["sigma"], 2)) == (33.52, 0.48)
    # The book computes with the rounded mean, range and constants.
    assert (chart["lower"], chart["upper"]) == pytest.approx((32.24, 34.80), abs=0.006)
    assert chart["beyond"] == ()


def test_another_program_finds_the_same_limits():
    """Pyspc is under the GPL: install it by hand."""
    pytest.importorskip("pyspc")
    from pyspc.ccharts.ewma import ewma as ewma_of
    from pyspc.ccharts.mr import xmr

    data = np.array(VISCOSITY)
    chart = individuals(VISCOSITY)
    values, centre, lower, upper, _ = xmr().plot(data, 1)
    assert values == pytest.approx(data)
    assert (centre, lower, upper) == pytest.approx(
        (chart["centre"], chart["lower"], chart["upper"]), abs=1e-3
    )
    averages = ewma(VISCOSITY, chart["centre"], chart["sigma"], weight=0.2, limit=3.0)
    plotted, centre, lower, upper, _ = ewma_of().plot(data, 1)
    assert plotted == pytest.approx(averages["values"])
    assert lower == pytest.approx(averages["lower"], abs=1e-3)
    assert upper == pytest.approx(averages["upper"], abs=1e-3)


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


def run_lengths(shift, rng, charts=4000, most=6000):
    """Number of runs until a value is beyond three sigma, and until the average is beyond its limits."""
    alive, average = np.ones((2, charts), bool), np.zeros(charts)
    lengths = np.full((2, charts), float(most))
    for number in range(1, most + 1):
        x = rng.standard_normal(charts) + shift
        average = EWMA_WEIGHT * x + (1 - EWMA_WEIGHT) * average
        half = EWMA_LIMIT * float(ewma_sigma(np.array([float(number)]), 1.0, EWMA_WEIGHT)[0])
        for place, beyond in enumerate((np.abs(x) > E2 * D2, np.abs(average) > half)):
            now = alive[place] & beyond
            lengths[place, now] = number
            alive[place] &= ~beyond
        if not alive.any():
            break
    return lengths.mean(axis=1)


def test_a_parameter_in_control_leaves_its_limits_once_in_370_runs():
    """Theory: 1 / 0.0027 = 370.4 for values. The averages' limits are narrower at first, so a little less than 370."""
    values, averages = run_lengths(0.0, np.random.default_rng(1))
    assert values == pytest.approx(370.4, rel=0.05)
    assert averages == pytest.approx(360.0, rel=0.06)


def test_the_average_shows_a_shift_of_one_sigma_in_about_ten_runs_and_values_in_44():
    """Montgomery: 43.9 runs for a chart of individuals; about 10 for EWMA with these properties."""
    values, averages = run_lengths(1.0, np.random.default_rng(2))
    assert values == pytest.approx(43.9, rel=0.06)
    assert 8.0 < averages < 10.5


def markov_run_length(weight, limit, shift=0.0, cells=301):
    """Average run length with limits that do not widen: Lucas and Saccucci, Technometrics 32 (1990) 1."""
    half = limit * math.sqrt(weight / (2 - weight))
    width = 2 * half / cells
    middle = -half + width * (np.arange(cells) + 0.5)
    normal = np.vectorize(lambda z: 0.5 * math.erfc(-z / math.sqrt(2)))
    ends = (middle[None, :] - (1 - weight) * middle[:, None]) / weight - shift
    step = normal(ends + width / (2 * weight)) - normal(ends - width / (2 * weight))
    return float(np.linalg.solve(np.eye(cells) - step, np.ones(cells))[cells // 2])


def test_the_chosen_limit_of_the_average_has_the_run_length_of_three_sigma():
    assert markov_run_length(0.2, 2.962) == pytest.approx(500, rel=0.01)  # published, Lucas and Saccucci
    assert markov_run_length(0.2, 2.962, 1.0) == pytest.approx(10.5, rel=0.02)  # published
    assert markov_run_length(EWMA_WEIGHT, EWMA_LIMIT) == pytest.approx(370, rel=0.02)


# ---------------------------------------------------------------- drift

NO_WARMTH = [None] * 400


def test_another_program_finds_the_same_slope_and_uncertainty():
    api = pytest.importorskip("statsmodels.api")
    rng = np.random.default_rng(1)
    days, u = np.arange(30.0), rng.uniform(1.5, 4.5, 30)
    y = 3345.0 + 0.2 * days + rng.normal(0, 0.5 * u)  # scatters less than stated: tau is 0
    drift = find_drift(days, NO_WARMTH[:30], y, u)
    fit = api.WLS(y, api.add_constant(days), weights=1 / u**2).fit()
    assert drift.between_runs == 0.0
    assert (drift.per_day["value"], drift.per_day["sigma"]) == pytest.approx((fit.params[1], fit.bse[1]))
    assert drift.per_day["p"] == pytest.approx(fit.pvalues[1])


def test_another_program_finds_the_same_scatter_between_runs():
    analysis = pytest.importorskip("statsmodels.stats.meta_analysis")
    rng = np.random.default_rng(2)
    u = rng.uniform(0.5, 1.5, 4)
    y = rng.normal(0, 3.0, 4)
    # With fewer than five runs there is no fit, so the mean alone is compared, with more runs and no slope.
    u, y = np.tile(u, 5), np.concatenate([y + n for n in rng.normal(0, 2.0, 5)])
    drift = find_drift([0.0] * 20, NO_WARMTH[:20], y, u)
    combined = analysis.combine_effects(y, u**2, method_re="iterated")
    assert drift.between_runs**2 == pytest.approx(combined.tau2, rel=1e-4)
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

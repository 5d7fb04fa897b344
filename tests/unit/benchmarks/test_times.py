"""Times that benchmarks print: the median and the 95th percentile; and a page that is calculated from what was measured."""

import re
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

import bench_costs
import measured

COSTS = bench_costs.Costs(0.2, 0.01, 0.7, 0.1, 0.02, 1.5, 4.0, 19.0, 0.6, 500.0, 200.0)


def test_one_slow_time_of_twenty_is_in_the_percentile_and_not_in_the_median():
    assert measured.spread([1.0] * 19 + [9.0]) == (1.0, pytest.approx(1.4))
    assert measured.spread([1.0] * 18 + [9.0] * 2) == (1.0, 9.0)
    assert measured.spread([3.0]) == (3.0, 3.0)
    assert (measured.spread([2.0, 4.0]) / 2).median_s == 1.5


def test_the_page_of_costs_follows_from_what_was_measured():
    page = bench_costs.explained(COSTS, 2.0)
    assert "**Finding stars takes the most time**: 69%" in page
    assert "takes 2.6 s of" in page
    assert "1,000,000 captures in 3.3 d of one" in page
    slow_fit = bench_costs.explained(COSTS._replace(fit_s=7.0), 2.0)
    assert "**The fit takes the most time**" in slow_fit


def test_the_page_of_costs_is_as_the_benchmark_writes_it():
    """Its words are those of the benchmark; only its numbers follow a measurement."""
    numbers = re.compile(r"[0-9][0-9,.]*( [smhd]\b| min\b)?")

    def words(text):
        return re.sub(r"\s+", " ", numbers.sub("#", text))

    shown = (measured.FOLDER / "costs.md").read_text(encoding="utf-8")
    assert words(bench_costs.explained(COSTS, 2.0)) in words(shown)

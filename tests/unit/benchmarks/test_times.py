"""Times that benchmarks print: the median and the 95th percentile."""

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

import measured


def test_one_slow_time_of_twenty_is_in_the_percentile_and_not_in_the_median():
    assert measured.spread([1.0] * 19 + [9.0]) == (1.0, pytest.approx(1.4))
    assert measured.spread([1.0] * 18 + [9.0] * 2) == (1.0, 9.0)
    assert measured.spread([3.0]) == (3.0, 3.0)
    assert (measured.spread([2.0, 4.0]) / 2).median_s == 1.5

"""The median of the adjustment is that of NumPy."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.model.median import median


@given(st.lists(st.floats(-1e6, 1e6) | st.just(math.inf), min_size=1, max_size=30))
def test_it_is_the_median_of_numpy(numbers):
    assert median(np.array(numbers)) == np.median(numbers)


@pytest.mark.parametrize("numbers", [[], [1.0, math.nan, 2.0], [math.nan]])
def test_without_a_middle_it_is_not_a_number(numbers):
    assert math.isnan(median(np.array(numbers)))

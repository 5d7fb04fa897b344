"""Where values stand along an axis, and the numbers at its ticks."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from bench.report.svg_plot import Scale, log_ticks, text_width, tick_labels, ticks

FINITE = st.floats(-1e6, 1e6)


@given(FINITE, st.floats(1e-3, 1e6), st.integers(2, 12))
@example(1.0, 400_001.0, 2)  # the round number next to it, 500,000, lies outside
def test_ticks_are_few_round_numbers_within_the_range(low, span, most):
    found = ticks(low, low + span, most)
    assert 1 <= len(found) <= most + 1
    step = found[1] - found[0] if len(found) > 1 else 1.0
    assert all(low - 1e-6 * step - 1e-9 <= value <= low + span + 1e-6 * step + 1e-9 for value in found)
    if len(found) > 1:
        assert float(f"{step:.0e}") == pytest.approx(step, rel=1e-6)
        assert len(set(tick_labels(found))) == len(found)


def test_a_range_that_is_upside_down_has_its_first_value_at_the_bottom():
    rows = Scale(719.5, -0.5)
    np.testing.assert_allclose(rows.share([719.5, 359.5, -0.5]), [0, 0.5, 1])
    assert [label for _, label in rows.chosen_ticks(4)] == ["0", "200", "400", "600"]


def test_a_logarithmic_axis_spreads_ratios_evenly_and_has_round_numbers():
    np.testing.assert_allclose(Scale(1, 100, "log").share([1, 10, 100]), [0, 0.5, 1])
    assert log_ticks(0.7, 30) == [1, 2, 5, 10, 20]
    assert log_ticks(1e-4, 1e4, 5)[0] == 1e-4
    assert set(np.log10(log_ticks(1e-4, 1e4, 5)) % 1) == {0}
    assert log_ticks(3.1, 3.9) == [3.2, 3.4000000000000004, 3.6, 3.8000000000000003]
    assert [label for _, label in Scale(3.1, 3.9, "log").chosen_ticks(5)] == ["3.2", "3.4", "3.6", "3.8"]


def test_a_two_sided_axis_is_linear_near_zero_and_logarithmic_beyond():
    scale = Scale(-500, 500, "symlog", 5.0)
    shares = scale.share([-500, -50, -5, 0, 2.5, 5, 50, 500])
    np.testing.assert_allclose(shares, np.array([0, 1, 2, 3, 3.5, 4, 5, 6]) / 6)


def test_a_wider_text_is_estimated_as_wider():
    assert text_width("column, px", 9) < text_width("COLUMN, px", 9)
    assert text_width("\N{CJK UNIFIED IDEOGRAPH-5C71}", 10) > text_width("l", 10)

"""How right the numbers are: some rows of the table of `tests/benchmarks/bench_truth.py`, and some drawn benches."""

import pytest

from tests.benchmarks import bench_coverage
from tests.support.truth_table import BY_NAME, solve, solve_all

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    "name", ["ideal-flat", "S3", "like-bench", "S3-certificate", "like-bench-certificate", "bow-50-9-radial"]
)
def test_a_bench_with_what_its_station_states_is_as_right_as_asked(name):
    row = BY_NAME[name]
    solved, refused = solve_all(row, (100,))
    assert not refused
    for one in solved:
        assert abs(one.error_px) <= min(row.asked.error_px or one.expanded_px, one.expanded_px)
        assert one.corner_urad <= (row.asked.corner_urad or 250)
        if row.asked.expanded_px:
            assert one.expanded_px <= 1.2 * row.asked.expanded_px[1]


def test_without_bound_or_certificate_the_uncertainty_is_wide_and_holds():
    one = solve(BY_NAME["S1-unbound"], 100)
    assert abs(one.error_px) < one.expanded_px
    assert one.expanded_px > 20


def test_repeats_of_a_bad_collimator_do_not_shrink_the_uncertainty():
    once, repeated = solve(BY_NAME["S1-once"], 102), solve(BY_NAME["S1-repeats"], 102)
    assert repeated.expanded_px == pytest.approx(once.expanded_px, rel=0.15)


def test_drawn_benches_are_within_their_uncertainty_or_a_note_names_the_trouble():
    lines = [bench_coverage.measure(2, index) for index in range(4)]
    solved = [line for line in lines if "refused" not in line]
    assert len(solved) >= 3
    for line in solved:
        ratio = max(bench_coverage.over(line, what) for what in ("fx", "corner"))
        assert ratio <= 1.5 or bench_coverage.named(line)

"""Of many poses a page pictures few: the worst, those with gates not passed, others evenly; and says so."""

import numpy as np
import pytest

from bench.measure.view_picture import ViewPicture
from bench.report.pictured_poses import pictured_poses, thinned

MOST = 24


def results_of(rms_px, verdicts=None):
    """Results of poses with these residuals; verdicts by place."""
    poses = [{"index": i, "name": f"p{i - 1}", "rms_px": rms} for i, rms in enumerate(rms_px, 1)]
    gates = [
        {"name": f"pose {place + 1}: stars", "gate": "stars", "pose": place + 1, "verdict": verdict}
        for place, verdict in (verdicts or {}).items()
    ]
    return {"poses": poses, "gates": [{"name": "rms", "verdict": "fail"}, *gates]}


def places(choice):
    return sorted(int(name[1:]) for name in choice.names)


def test_the_worst_come_first_then_failed_then_marginal_gates_then_others_evenly():
    rms = [0.1] * 1000
    rms[7] = rms[333] = rms[998] = 0.3
    chosen = places(pictured_poses(results_of(rms, {500: "fail", 77: "marginal", 12: "pass"})))
    assert {7, 333, 998, 500, 77, 0, 999} <= set(chosen)
    assert len(chosen) == MOST
    others = [place for place in chosen if place not in {7, 333, 998, 500, 77}]
    assert max(np.diff(others)) - min(np.diff(others)) <= 6


def test_failed_gates_leave_no_room_for_marginal_ones_and_are_spread_where_too_many():
    verdicts = {place: "fail" if place % 2 else "marginal" for place in range(100, 200)}
    chosen = places(pictured_poses(results_of([0.3, 0.3, 0.3, *[0.1] * 297], verdicts)))
    assert chosen[:3] == [0, 1, 2]
    assert (chosen[3], chosen[-1], len(chosen)) == (101, 199, MOST)
    assert all(place % 2 for place in chosen[3:])


def stars(n, views):
    grid = np.column_stack([np.arange(n) % 20 * 15.0, np.arange(n) // 20 * 9.0])
    return [ViewPicture(f"v{i}", None, grid + 0.1, grid, np.arange(n)) for i in range(views)]


@pytest.mark.parametrize("n", [100, 240, 310])
def test_of_many_stars_other_ones_are_drawn_from_view_to_view(n):
    views = stars(n, 200)
    kept = thinned(views, 200 * 12)
    counts = [len(view.ids) for view in kept]
    assert abs(sum(counts) - 200 * 12) <= 2
    assert max(counts) - min(counts) <= 4
    assert len(set(np.concatenate([view.ids for view in kept]))) == n
    for view, all_of_it in zip(kept, views, strict=True):
        np.testing.assert_array_equal(view.detected, all_of_it.detected[view.ids])
        np.testing.assert_array_equal(view.reprojected, all_of_it.reprojected[view.ids])

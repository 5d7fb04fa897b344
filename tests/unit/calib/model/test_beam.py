"""The visible disc is found from the stars present and absent."""

import numpy as np
import pytest

from calib.engine import CalibrationOptions, calibrate
from calib.model.beam import inside_guard_band, visible_disc, visible_discs


def test_centre_and_radius_are_found_within_the_stated_uncertainty(make_bench):
    rng = np.random.default_rng(51)
    bench = make_bench(half_angle_deg=4.8, centre=(97.0, 100.0, -255.0))
    off = []
    for i in range(12):
        disc = np.array(bench.centre[:2]) + rng.uniform(-8, 8, 2)
        view = bench.view(f"{i}", bench.turn(0.0, 0.0, 30.0 * i), disc=disc)
        found = visible_disc(view)
        off.append((found.centre_mm - disc) / found.sigma_mm)
        assert found.radius_mm == pytest.approx(255.0 * np.tan(np.deg2rad(4.8)), abs=0.7)
    assert 0.3 < np.sqrt(np.mean(np.square(off))) < 1.5


def test_stars_missing_inside_hardly_move_it(make_bench):
    bench = make_bench(half_angle_deg=4.8, centre=(97.0, 100.0, -255.0))
    view = bench.view("one", bench.turn(0.0, 0.0))
    kept = np.random.default_rng(52).random(len(view)) > 0.05
    thinned = type(view)(
        view.name,
        view.image_size,
        view.ids[kept],
        view.points_px[kept],
        view.target_mm[kept],
        view.covariances_px2[kept],
    )
    assert np.abs(visible_disc(thinned).centre_mm - visible_disc(view).centre_mm).max() < 1.0


def test_a_rim_out_of_view_leaves_the_centre_unknown(make_bench):
    bench = make_bench(half_angle_deg=20.0)
    assert visible_disc(bench.view("full", bench.turn(0.0, 0.0))).sigma_mm > 10.0


def test_the_guard_band_holds_the_outer_stars(make_bench):
    bench = make_bench(half_angle_deg=4.8, centre=(97.0, 100.0, -255.0))
    view = bench.view("one", bench.turn(0.0, 0.0))
    disc = visible_disc(view)
    inside = inside_guard_band(view, disc, 0.8)
    assert 0.5 * len(view) < inside.sum() < 0.75 * len(view)
    assert np.linalg.norm(view.target_mm[inside] - disc.centre_mm, axis=1).max() <= 0.8 * disc.radius_mm
    assert inside_guard_band(view, disc, 1.0).all()


def test_stars_on_no_grid_leave_the_centre_unknown(make_bench):
    bench = make_bench(half_angle_deg=4.8, centre=(97.0, 100.0, -255.0))
    view = bench.view("one", bench.turn(0.0, 0.0))
    moved = view.target_mm + np.random.default_rng(53).uniform(-1, 1, view.target_mm.shape)
    scattered = type(view)(view.name, view.image_size, view.ids, view.points_px, moved, view.covariances_px2)
    assert visible_disc(scattered).sigma_mm == np.inf


def test_stars_of_the_guard_band_are_shown_but_not_used(defocused):
    _, views = defocused
    views[0].points_px[
        np.linalg.norm(views[0].target_mm - visible_disc(views[0]).centre_mm, axis=1) > 19
    ] += 2
    guarded = calibrate(views, CalibrationOptions(model="pupil", guard_band=0.8))
    assert [len(r) for r in guarded.residuals_px] == [len(view) for view in views]
    assert all(view.n < len(r) for view, r in zip(guarded.views, guarded.residuals_px, strict=True))
    assert guarded.rms_px < 0.05
    outside = guarded.weights[0] == 0
    assert np.linalg.norm(guarded.residuals_px[0][outside], axis=1).max() > 1


@pytest.fixture
def partly_seen(make_bench):
    """Six views and their discs' centres; of the last two discs the small frame shows only a part."""
    bench = make_bench(half_angle_deg=4.8, centre=(97.0, 100.0, -255.0), size=(700, 640), cx=352.0, cy=323.0)
    discs = np.array(bench.centre[:2]) + np.random.default_rng(54).uniform(-4, 4, (6, 2))
    poses = [*((0, 0, 30 * i) for i in range(4)), (7, 3), (-6, 5)]
    views = [bench.view(f"{i}", bench.turn(*pose), disc=discs[i]) for i, pose in enumerate(poses)]
    return views, discs


def test_other_views_locate_a_disc_whose_rim_is_out_of_view(partly_seen):
    views, truth = partly_seen
    alone = np.array([visible_disc(view).centre_mm for view in views])
    discs = visible_discs(views)
    together = np.array([disc.centre_mm for disc in discs])
    assert [disc.uses_other_views for disc in discs] == [False] * 4 + [True] * 2
    np.testing.assert_array_equal(together[:4], alone[:4])
    assert np.linalg.norm(alone - truth, axis=1)[4:].min() > 10.0
    assert np.linalg.norm(together - truth, axis=1).max() < 2.5


def test_where_no_view_shows_its_rim_nothing_is_borrowed(make_bench):
    bench = make_bench(half_angle_deg=20.0)
    discs = visible_discs(bench.views())
    assert not any(disc.rim_visible or disc.uses_other_views for disc in discs)

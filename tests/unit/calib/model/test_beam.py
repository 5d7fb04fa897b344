"""The visible discs are found from the stars present and absent."""

from dataclasses import replace

import numpy as np
import pytest
from made_views import shifted

from calib.engine import CalibrationOptions, calibrate
from calib.model.beam import inside_guard_band, visible_discs


@pytest.fixture
def small_disc(make_bench):
    """A bench whose views show the whole disc."""
    return make_bench(half_angle_deg=4.8, centre=(97.0, 100.0, -255.0))


@pytest.fixture
def partly_seen(make_bench):
    """Six views and their discs' centres; of the last two discs the small frame shows only a part."""
    bench = make_bench(half_angle_deg=4.8, centre=(97.0, 100.0, -255.0), size=(700, 640), cx=352.0, cy=323.0)
    discs = np.array(bench.centre[:2]) + np.random.default_rng(54).uniform(-4, 4, (6, 2))
    poses = [*((0, 0, 30 * i) for i in range(4)), (7, 3), (-6, 5)]
    views = [bench.view(f"{i}", bench.turn(*pose), disc=discs[i]) for i, pose in enumerate(poses)]
    return views, discs


def test_centre_and_radius_are_found_within_the_stated_uncertainty(small_disc):
    rng = np.random.default_rng(51)
    true = np.array(small_disc.centre[:2]) + rng.uniform(-8, 8, (12, 2))
    turns = [small_disc.turn(0.0, 0.0, 30.0 * i) for i in range(len(true))]
    views = [small_disc.view(f"{i}", turns[i], disc=disc) for i, disc in enumerate(true)]
    discs = visible_discs(views)
    off = [
        (disc.centre_mm - centre_mm) / np.sqrt(np.diag(disc.covariance_mm2))
        for disc, centre_mm in zip(discs, true, strict=True)
    ]
    assert 0.3 < np.sqrt(np.mean(np.square(off))) < 1.5
    radius = 255.0 * np.tan(np.deg2rad(4.8))
    assert all(disc.radius_mm == pytest.approx(radius, abs=0.7) for disc in discs)


def test_stars_missing_inside_hardly_move_it(small_disc):
    view = small_disc.view("one", small_disc.turn(0.0, 0.0))
    thinned = view.part(np.random.default_rng(52).random(len(view)) > 0.05)
    whole, thin = (visible_discs([seen])[0].centre_mm for seen in (view, thinned))
    assert np.abs(thin - whole).max() < 1.0


@pytest.mark.parametrize("missed", [0.1, 0.3])
@pytest.mark.parametrize("half_angle_deg", [8.0, 12.0])
def test_stars_that_are_missed_are_no_rim(make_bench, half_angle_deg, missed):
    bench = make_bench(half_angle_deg=half_angle_deg, centre=(97.0, 100.0, -255.0))
    rng = np.random.default_rng(3)
    views = bench.views(poses=[(pan, tilt) for pan in (-5, 0, 5) for tilt in (-4, 0, 4)])
    discs = visible_discs([view.part(rng.random(len(view)) > missed) for view in views])
    off = [(disc.centre_mm - bench.centre[:2]) / np.sqrt(np.diag(disc.covariance_mm2)) for disc in discs]
    assert len(off) == len(views)
    assert np.sqrt(np.mean(np.square(off))) < 2.0
    assert np.abs(off).max() < 4.0


def test_a_few_stars_about_a_missed_one_are_enough_to_go_on(small_disc):
    view = small_disc.view("few", small_disc.turn(0.0, 0.0))
    distance_mm = np.linalg.norm(view.target_mm - view.target_mm[len(view) // 2], axis=1)
    ring = view.part((distance_mm > 0.0) & (distance_mm < 1.1 * np.sort(distance_mm)[1]))
    assert len(ring) == 4
    assert len(visible_discs([ring, view])) == 2


def test_a_tag_without_stars_is_no_rim(make_bench):
    """Tags of reticles take the place of 5 x 5 stars; where a view shows few stars, they are a large part of it."""
    bench = make_bench(half_angle_deg=8.0, centre=(97.0, 100.0, -255.0), fx=4400.0, fy=4400.0)
    views = bench.views(poses=((-6.0, 3.0), (6.0, 2.0), (0.0, -4.0), (0.0, 0.0)))
    middle = np.mean([view.target_mm.mean(axis=0) for view in views], axis=0)
    tagged = [view.part(np.abs(view.target_mm - middle).max(axis=1) > 10.0) for view in views]
    assert all(len(tag_view) < len(view) for tag_view, view in zip(tagged, views, strict=True))
    for disc in visible_discs(tagged):
        assert np.abs(disc.centre_mm - bench.centre[:2]).max() < 6.0
        assert disc.radius_mm == pytest.approx(255.0 * np.tan(np.deg2rad(8.0)), abs=6.0)


def test_where_no_view_shows_its_rim_no_disc_is_known(make_bench):
    assert visible_discs(make_bench(half_angle_deg=20.0).views()) == []


def test_the_guard_band_holds_the_outer_stars(small_disc):
    view = small_disc.view("one", small_disc.turn(0.0, 0.0))
    (disc,) = visible_discs([view])
    inside = inside_guard_band(view, disc, 0.8)
    assert 0.5 * len(view) < inside.sum() < 0.75 * len(view)
    assert np.linalg.norm(view.target_mm[inside] - disc.centre_mm, axis=1).max() <= 0.8 * disc.radius_mm
    assert inside_guard_band(view, disc, 1.0).all()


def test_stars_on_no_grid_show_no_rim(small_disc):
    view = small_disc.view("one", small_disc.turn(0.0, 0.0))
    moved = view.target_mm + np.random.default_rng(53).uniform(-1, 1, view.target_mm.shape)
    assert visible_discs([replace(view, target_mm=moved)]) == []


def test_stars_of_the_guard_band_are_shown_but_not_used(defocused):
    _, views = defocused
    centre = visible_discs(views)[0].centre_mm
    outer = np.linalg.norm(views[0].target_mm - centre, axis=1) > 19
    views = [shifted(views[0], outer, 2), *views[1:]]
    guarded = calibrate(views, CalibrationOptions(guard_band=0.8))
    assert [len(r) for r in guarded.residuals_px] == [len(view) for view in views]
    assert all(view.n < len(r) for view, r in zip(guarded.views, guarded.residuals_px, strict=True))
    assert guarded.rms_px < 0.05
    outside = guarded.weights[0] == 0
    assert np.linalg.norm(guarded.residuals_px[0][outside], axis=1).max() > 1


def test_other_views_locate_a_disc_whose_rim_is_out_of_view(partly_seen):
    views, truth = partly_seen
    alone = np.array([visible_discs([view])[0].centre_mm for view in views])
    together = visible_discs(views)
    assert [disc.rim_visible for disc in together][:4] == [True] * 4
    found = np.array([disc.centre_mm for disc in together])
    off = [np.linalg.norm(centres - truth, axis=1) for centres in (alone, found)]
    assert off[1].max() < min(2.5, off[0][4:].min())

"""Vignetted stars: found by the neighbours that they lack, and given less weight."""

import numpy as np
import pytest

from calib.stars.vignetting import downweight_vignetted, vignetted_stars
from calib.target import StarTarget
from calib.view import View

TARGET = StarTarget()
PITCH_PX = 50.0
SIZE = (1280, 720)


def view(radius_mm, *, turn_deg=20.0, without=()):
    """Return a view of a beam of that radius about the tag, with the camera turned about its axis."""
    positions = TARGET.positions_mm(TARGET.ids)
    away = positions - TARGET.tag_centre_mm
    turn = np.radians(turn_deg)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    points = away @ rotation.T * (PITCH_PX / TARGET.pitch_mm) + [640.0, 360.0]
    framed = ((points > 25) & (points < np.array(SIZE) - 26)).all(axis=1)
    kept = framed & (np.hypot(*away.T) < radius_mm) & ~np.isin(TARGET.ids, without)
    n = int(kept.sum())
    return View(
        "v", SIZE, TARGET.ids[kept], points[kept], positions[kept], np.tile(0.0004 * np.eye(2), (n, 1, 1))
    )


def distance_mm(seen):
    return np.hypot(*(seen.target_mm - TARGET.tag_centre_mm).T)


@pytest.mark.parametrize("turn_deg", [0.0, 20.0, 45.0, 170.0])
def test_the_outermost_ring_of_a_beam_inside_the_frame_is_the_rim_and_no_other_star(turn_deg):
    seen = view(20.0, turn_deg=turn_deg)
    rim = vignetted_stars(seen, TARGET)
    away = distance_mm(seen)
    assert rim[away > 20.0 - TARGET.pitch_mm].all()
    assert not rim[away < 20.0 - 1.5 * TARGET.pitch_mm].any()


def test_where_the_frame_or_the_tag_ends_the_stars_there_is_no_rim():
    assert not vignetted_stars(view(1000.0), TARGET).any()


def test_the_neighbours_of_a_star_that_was_missed_count_as_rim():
    missed = int(TARGET.id_at(29, 35))
    whole, holed = view(1000.0), view(1000.0, without=[missed])
    rim = vignetted_stars(holed, TARGET)
    assert rim.sum() == 8
    assert np.abs(TARGET.node_of(holed.ids[rim]) - [29, 35]).max() == 1
    assert len(whole) == len(holed) + 1


def test_only_vignetted_stars_get_less_weight():
    seen = view(20.0)
    rim = vignetted_stars(seen, TARGET)
    weighted = downweight_vignetted(seen, TARGET, 0.3)
    np.testing.assert_allclose(
        weighted.covariances_px2[rim], np.broadcast_to(0.0904 * np.eye(2), (rim.sum(), 2, 2))
    )
    np.testing.assert_array_equal(weighted.covariances_px2[~rim], seen.covariances_px2[~rim])
    np.testing.assert_array_equal(weighted.points_px, seen.points_px)

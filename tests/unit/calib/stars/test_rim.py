"""The rim of the beam in an image: found where the light ends, and nowhere else."""

import numpy as np
import pytest

from calib.stars.rim import find_rim
from calib.target import StarTarget
from calib.view import View

TARGET = StarTarget()
PITCH_PX, SIZE = 50.0, (1280, 720)
MIDDLE = np.array(TARGET.tag_centre_mm)


def picture(centre_mm, radius_mm, look_mm, *, wave=0.0, fall_mm=0.0, noise=0.0, turn_deg=10.0):
    """Return an image of a lit disc of the target and its view; the edge has three waves, the light falls to the rim."""
    turn, px_per_mm = np.radians(turn_deg), PITCH_PX / TARGET.pitch_mm
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    middle_px = (np.array(SIZE) - 1) / 2
    shape = (SIZE[1], SIZE[0])
    v, u = np.indices(shape)
    level = np.zeros(shape)
    for du, dv in ((-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)):
        at = (np.stack([u + du, v + dv], axis=-1) - middle_px) @ rotation / px_per_mm + look_mm
        level += (
            0.25 * TARGET.reflectance(at[..., 0], at[..., 1]) * light(at, centre_mm, radius_mm, wave, fall_mm)
        )
    image = level + noise * np.random.default_rng(3).standard_normal(shape)
    positions = TARGET.positions_mm(TARGET.ids)
    points = (positions - look_mm) @ rotation.T * px_per_mm + middle_px
    framed = ((points > 25) & (points < np.array(SIZE) - 26)).all(axis=1)
    seen = framed & (light(positions, centre_mm, 0.97 * radius_mm, wave, 0.0) > 0)
    n = int(seen.sum())
    return image, View(
        "v", SIZE, TARGET.ids[seen], points[seen], positions[seen], np.tile(np.eye(2) * 1e-4, (n, 1, 1))
    )


def edge_of(away, radius_mm, wave):
    return radius_mm * (1 + wave * np.cos(3 * np.arctan2(away[..., 1], away[..., 0])))


def light(at, centre_mm, radius_mm, wave, fall_mm):
    """Return 1 inside the disc and 0 outside, falling from 1 to 0 over ``fall_mm``."""
    away = at - centre_mm
    inside = edge_of(away, radius_mm, wave) - np.hypot(away[..., 0], away[..., 1])
    return np.clip(inside / fall_mm, 0, 1) if fall_mm else (inside > 0).astype(float)


def off_mm(rim, centre_mm, radius_mm, wave=0.0, fall_mm=0.0):
    """Return how far the points lie outside of the place of half the light."""
    away = rim.points_mm - centre_mm
    return np.hypot(*away.T) - edge_of(away, radius_mm, wave) + 0.5 * fall_mm


@pytest.mark.parametrize(
    ("wave", "fall_mm", "noise"), [(0.0, 0.0, 0.0), (0.06, 0.0, 0.0), (0.0, 4.0, 0.05), (0.06, 2.0, 0.1)]
)
def test_the_points_lie_where_the_light_ends(wave, fall_mm, noise):
    centre = MIDDLE + np.array([1.0, -2.0])
    image, view = picture(
        centre, 50.0, MIDDLE + np.array([35.0, 15.0]), wave=wave, fall_mm=fall_mm, noise=noise
    )
    rim = find_rim(image, view, TARGET)
    off = off_mm(rim, centre, 50.0, wave, fall_mm)
    assert len(off) >= 8
    # The level of 1 is the median over the view, and the light falls over part of it.
    assert abs(np.median(off)) < 0.05 + 0.05 * fall_mm
    assert np.sqrt(np.mean((off - np.median(off)) ** 2)) < 0.12
    assert (rim.sigmas_mm < 0.4).all()
    inside = np.hypot(*(rim.lit_mm - centre).T) < edge_of(rim.lit_mm - centre, 50.0, wave)
    assert inside.all()


def test_a_rim_that_bends_inwards_is_followed():
    centre, look = MIDDLE, MIDDLE + np.array([-45.0, 0.0])
    image, view = picture(centre, 50.0, look, wave=0.15)
    off = off_mm(find_rim(image, view, TARGET), centre, 50.0, 0.15)
    assert len(off) >= 8
    assert np.abs(off).max() < 0.5


def test_a_whole_rim_in_the_frame_is_found_all_around():
    centre = MIDDLE + np.array([2.0, 1.0])
    image, view = picture(centre, 22.0, MIDDLE)
    rim = find_rim(image, view, TARGET)
    assert len(rim.points_mm) > 0.8 * 2 * np.pi * 22.0 / TARGET.pitch_mm
    assert np.abs(off_mm(rim, centre, 22.0)).max() < 0.3
    assert len(rim.lit_mm) == 0


def test_a_frame_inside_the_beam_shows_only_that_the_rim_lies_farther_out():
    image, view = picture(MIDDLE, 200.0, MIDDLE)
    rim = find_rim(image, view, TARGET)
    assert len(rim.points_mm) == 0
    assert np.hypot(*(rim.lit_mm - MIDDLE).T).max() > 52.0


def test_a_dark_spot_inside_the_beam_is_no_rim():
    image, view = picture(MIDDLE, 200.0, MIDDLE)
    image[200:320, 300:430] = 0.0
    spoilt = (view.points_px > [290, 190]).all(axis=1) & (view.points_px < [440, 330]).all(axis=1)
    kept = View(
        "v", SIZE, *(a[~spoilt] for a in (view.ids, view.points_px, view.target_mm, view.covariances_px2))
    )
    assert len(find_rim(image, kept, TARGET).points_mm) == 0


def test_an_image_without_contrast_shows_no_rim():
    image, view = picture(MIDDLE, 200.0, MIDDLE)
    noise = np.random.default_rng(1).standard_normal(image.shape)
    assert find_rim(noise, view, TARGET) is None


def test_an_image_of_bytes_shows_the_same_rim():
    centre = MIDDLE + np.array([1.0, -2.0])
    image, view = picture(centre, 50.0, MIDDLE + np.array([35.0, 15.0]))
    grey = np.round(200 * image).astype(np.uint8)
    rim, same = find_rim(image, view, TARGET), find_rim(grey, view, TARGET)
    np.testing.assert_allclose(same.points_mm, rim.points_mm, atol=0.02)

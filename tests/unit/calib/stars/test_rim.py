"""The rim of the visible disc, and the edges that show it."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from calib import StarTarget, View
from calib.stars.beam import find_beam
from calib.stars.centring import SYMMETRY_REACH
from calib.stars.edge_pixels import gather_edge_pixels
from calib.stars.grid_map import LocalMap
from calib.stars.printed_star import blurred_edge_map, render_star
from calib.stars.rim import find_rim
from simulators.optics.picture import beam_of, disc_of, project, true_rotation
from tests.support.live_slices import bench, fired, seen

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
        lit = light(at, centre_mm, radius_mm, wave, fall_mm)
        level += 0.25 * TARGET.reflectance(at[..., 0], at[..., 1]) * lit
    image = level + noise * np.random.default_rng(3).standard_normal(shape)
    positions = TARGET.positions_mm(TARGET.ids)
    points = (positions - look_mm) @ rotation.T * px_per_mm + middle_px
    framed = ((points > 25) & (points < np.array(SIZE) - 26)).all(axis=1)
    seen = framed & (light(positions, centre_mm, 0.97 * radius_mm, wave, 0.0) > 0)
    return image, View("v", SIZE, TARGET.ids[seen], points[seen], positions[seen], 0.01)


def edge_of(from_centre_mm, radius_mm, wave):
    return radius_mm * (1 + wave * np.cos(3 * np.arctan2(from_centre_mm[..., 1], from_centre_mm[..., 0])))


def light(at, centre_mm, radius_mm, wave, fall_mm):
    """Return 1 inside the disc and 0 outside, falling from 1 to 0 over ``fall_mm``."""
    from_centre_mm = at - centre_mm
    inside = edge_of(from_centre_mm, radius_mm, wave) - np.linalg.norm(from_centre_mm, axis=-1)
    return np.clip(inside / fall_mm, 0, 1) if fall_mm else (inside > 0).astype(float)


def off_mm(rim, centre_mm, radius_mm, wave=0.0, fall_mm=0.0):
    """Return how far the points lie outside of the place of half the light."""
    from_centre_mm = rim.points_mm - centre_mm
    return np.hypot(*from_centre_mm.T) - edge_of(from_centre_mm, radius_mm, wave) + 0.5 * fall_mm


@pytest.mark.parametrize(
    ("wave", "fall_mm", "noise"), [(0.0, 0.0, 0.0), (0.06, 0.0, 0.0), (0.0, 4.0, 0.05), (0.06, 2.0, 0.1)]
)
def test_the_points_lie_where_the_light_ends(wave, fall_mm, noise):
    centre = MIDDLE + np.array([1.0, -2.0])
    shown = {"wave": wave, "fall_mm": fall_mm, "noise": noise}
    image, view = picture(centre, 50.0, MIDDLE + np.array([35.0, 15.0]), **shown)
    rim = find_rim(image, view, TARGET)
    off = off_mm(rim, centre, 50.0, wave, fall_mm)
    assert len(off) >= 8
    # The level of 1 is the median over the view, and the light falls over part of it.
    assert abs(np.median(off)) < 0.05 + 0.05 * fall_mm
    assert np.sqrt(np.mean((off - np.median(off)) ** 2)) < 0.12
    assert (rim.sigmas_mm < 0.4).all()
    inside = np.hypot(*(rim.lit_mm - centre).T) < edge_of(rim.lit_mm - centre, 50.0, wave)
    assert inside.all()


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
    kept = view.part(~spoilt)
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


# ---------------------------------------------------------------- edges

PITCH = 24.0

EDGES = blurred_edge_map(render_star(TARGET, PITCH), TARGET.segments, PITCH, 0.75)

random = np.random.default_rng(11)

LEVELS = random.integers(0, 40, (80, 90), dtype=np.uint8)

LINEAR = np.array([[22.0, -8.0], [9.0, 23.0]])

QUADRATIC = np.array([[0.3, -0.2, 0.1], [0.05, 0.2, -0.3]])


def place_and_tau(centre):
    """Return place and tau of each pixel, (3, H W), by the equations of `gather_edge_pixels`."""
    rows, columns = np.mgrid[0 : LEVELS.shape[0], 0 : LEVELS.shape[1]]
    from_centre_px = np.array([columns.ravel() - centre[0], rows.ravel() - centre[1]], float)
    u, v = np.linalg.inv(LINEAR) @ from_centre_px
    u, v = np.linalg.inv(LINEAR) @ (from_centre_px - QUADRATIC @ [u * u, u * v, v * v])
    at = [EDGES.half + v * EDGES.samples_per_pitch, EDGES.half + u * EDGES.samples_per_pitch]
    return np.array([u, v, map_coordinates(EDGES.tau.astype(float), at, order=1, mode="nearest")])


@pytest.mark.parametrize("centre", [(45.3, 40.6), (5.1, 41.2), (84.0, 75.5)])
def test_pixels_are_those_of_scipy(centre):
    """The last stars reach beyond the image."""
    local_map = LocalMap(LINEAR[None], QUADRATIC[None])
    edge_pixels = gather_edge_pixels(LEVELS, np.array([centre]), local_map, EDGES)
    u, v, tau = place_and_tau(centre)
    slopes = [
        (place_and_tau(np.add(centre, step))[2] - place_and_tau(np.subtract(centre, step))[2]) / 2e-4
        for step in ([1e-4, 0.0], [0.0, 1e-4])
    ]
    used = (np.abs(tau) < EDGES.limit_px) & (np.abs(u) <= SYMMETRY_REACH) & (np.abs(v) <= SYMMETRY_REACH)
    expected = np.column_stack([u, v, tau, LEVELS.ravel(), *slopes])[used]
    fields = [getattr(edge_pixels, name) for name in ("u", "v", "tau", "level", "along_x", "along_y")]
    pixels = np.column_stack(fields).astype(float)
    assert len(pixels) == len(expected) == edge_pixels.first[-1]
    a, b = (rows_of[np.lexsort(rows_of[:, :2].round(3).T)] for rows_of in (pixels, expected))
    np.testing.assert_allclose(a[:, :4], b[:, :4], atol=2e-4)
    # The quadratic part of the map takes no part in the slopes, and they jump from sample to sample.
    assert np.median(np.abs(a[:, 4:] - b[:, 4:])) < 0.01
    assert np.mean(np.abs(a[:, 4:] - b[:, 4:]) > 0.1) < 0.02


def test_pixels_are_sorted_by_edges():
    local_map = LocalMap(LINEAR[None], QUADRATIC[None])
    edge_pixels = gather_edge_pixels(LEVELS, np.array([[45.3, 40.6]]), local_map, EDGES)
    edge = np.repeat(np.arange(TARGET.segments), np.diff(edge_pixels.first))
    turns = np.arctan2(edge_pixels.v, edge_pixels.u) / (2.0 * np.pi)
    nearest = np.round(turns * TARGET.segments) % TARGET.segments
    assert (edge == nearest).mean() > 0.97  # the edge map is sampled


def test_without_stars_there_are_no_pixels():
    no_map = LocalMap(np.zeros((0, 2, 2)), np.zeros((0, 2, 3)))
    edge_pixels = gather_edge_pixels(LEVELS, np.zeros((0, 2)), no_map, EDGES)
    assert len(edge_pixels.tau) == 0


# ---------------------------------------------------------------- the disc of the beam


def true_disc(truth, **angles_deg):
    """Centre and radius of the disc in the image, px, by points of its edge."""
    rotation = true_rotation(angles_deg, truth)
    disc = disc_of(beam_of(truth), rotation)
    turn = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    edge = np.column_stack([disc.x + disc.radius * np.cos(turn), disc.y + disc.radius * np.sin(turn)])
    points = project(edge, rotation, truth)
    middle = points.mean(axis=0)
    return middle, np.hypot(*(points - middle).T).mean()


@pytest.mark.parametrize("circle_px", [0.0, 18.0])
@pytest.mark.parametrize(
    "angles", [{"pan": 6.0}, {"pan": -7.0, "tilt": 2.0}, {"tilt": -8.0}, {"pan": 9.0, "tilt": 5.0}]
)
def test_the_disc_is_the_true_one_to_some_per_cent(angles, circle_px):
    truth = bench(circle_px=circle_px)
    share = seen(truth, **angles)
    beam = find_beam(fired(share))
    centre, radius = true_disc(truth, **angles)
    assert beam.share == pytest.approx(covered(centre, radius), abs=0.06)
    assert beam.radius_px == pytest.approx(radius, rel=0.08)
    assert np.hypot(*(np.array(beam.centre_px) - centre)) < 0.09 * radius


@pytest.mark.parametrize(
    "angles", [{"pan": 5.5, "tilt": -4.5}, {"pan": 3.4, "tilt": -2.8}, {"pan": -7.0}, {"tilt": -8.0}]
)
def test_with_the_radius_known_a_ragged_short_arc_shows_the_centre(angles):
    truth = bench(circle_px=15.0)
    centre, radius = true_disc(truth, **angles)
    beam = find_beam(fired(seen(truth, **angles)), radius_px=float(radius))
    assert beam.radius_px == pytest.approx(radius)
    assert np.hypot(*(np.array(beam.centre_px) - centre)) < 0.15 * radius


def test_a_short_arc_alone_shows_no_circle():
    v, u = np.indices((720, 1280))
    image = (np.hypot(u - 3300.0, v - 359.5) < 2900.0).astype(np.float32)  # an arc of 14 degrees
    beam = find_beam(image)
    assert (beam.centre_px, beam.radius_px) == (None, None)
    known = find_beam(image, radius_px=2900.0)
    assert known.centre_px == pytest.approx((3300.0, 359.5), abs=30.0)


def test_a_rim_that_does_not_fit_the_known_radius_shows_no_circle():
    v, u = np.indices((720, 1280))
    small = (np.hypot(u - 700.0, v - 350.0) < 200.0).astype(np.float32)
    assert find_beam(small, radius_px=200.0).centre_px == pytest.approx((700.0, 350.0), abs=5.0)
    assert find_beam(small, radius_px=600.0).centre_px is None


def covered(centre, radius):
    """Share of the frame inside a circle."""
    v, u = np.indices((720, 1280))
    return float((np.hypot(u - centre[0], v - centre[1]) < radius).mean())


def test_a_beam_that_fills_the_frame_shows_no_rim():
    beam = find_beam(np.ones((720, 1280), np.float32))
    assert (beam.share, beam.centre_px) == (1.0, None)


def test_no_light_is_no_beam():
    noise = (np.random.default_rng(1).random((720, 1280)) < 0.01).astype(np.float32)
    for image in (np.zeros((720, 1280), np.uint8), noise):
        beam = find_beam(image, least=0.3)
        assert (beam.share, beam.centre_px) == (0.0, None)


@pytest.mark.parametrize("shape", [(1, 1), (8, 8), (3, 200)])
def test_small_images_do_not_fail(shape):
    assert find_beam(np.zeros(shape)).share == 0.0
    assert find_beam(np.ones(shape)).share == 1.0


def test_dark_corners_show_a_rim_but_no_circle():
    beam = find_beam(fired(seen(bench(), pan=1.0)))
    assert (beam.centre_px, beam.radius_px) == (None, None)
    assert beam.share > 0.96

"""Focus figures against the blur that the simulated lens has."""

import numpy as np
import pytest

from calib.events.grey_image import to_uint8
from calib.model.homography import fit_homography
from calib.stars.beam import find_beam
from calib.stars.focus import blur_circle, contrast, edge_widths_px, sharpness
from calib.stars.quick import find_stars_quickly
from calib.stars.tag import find_tag
from simulators.optics.picture import TARGET, project, true_rotation
from tests.support.live_slices import bench, fired, seen


def grid_of(truth, **angles_deg):
    """The true homography of the grid."""
    nodes = TARGET.node_of(TARGET.ids).astype(float)
    points = project(np.asarray(TARGET.positions_mm(TARGET.ids)), true_rotation(angles_deg, truth), truth)
    inside = ((points > 0) & (points < [1280, 720])).all(axis=1)
    return fit_homography(nodes[inside], points[inside])


@pytest.mark.parametrize("circle_px", [6.0, 10.0, 16.0, 22.0])
def test_the_blur_circle_is_that_of_the_lens(circle_px):
    truth = bench(circle_px=circle_px, roll_deg=23.0)
    image = fired(seen(truth, pan=1.0), level_percent=10.0)
    tag = find_tag(to_uint8(image), TARGET)
    by_tag = blur_circle(image, tag.homography, TARGET)
    by_grid = blur_circle(image, grid_of(truth, pan=1.0), TARGET, enlarged=(1.0,))
    assert by_tag.diameter_px == pytest.approx(circle_px, abs=2.0)
    assert by_grid.diameter_px == pytest.approx(circle_px, abs=2.0)
    assert by_grid.explained > 0.5


@pytest.mark.parametrize("psf_px", [0.5, 0.7, 1.0])
def test_edge_widths_follow_the_blur_of_lens_and_pixel(psf_px):
    image = fired(seen(bench(psf_px=psf_px)))
    stars = find_stars_quickly(image, TARGET)
    every = np.arange(len(stars.ids))
    left = every[stars.points_px[:, 0] < 400]
    widths = edge_widths_px(image, stars.points_px, stars.local_map, TARGET, [every, left, every[:3]])
    assert 0.75 * psf_px <= widths[0] <= 1.1 * np.hypot(psf_px, 0.29)
    assert widths[1] == pytest.approx(widths[0], abs=0.06)
    assert widths[2] is None


@pytest.mark.parametrize(("level_percent", "pan"), [(100.0, 0.0), (20.0, 8.0)])
def test_the_sharpness_falls_with_the_blur(level_percent, pan):
    sharpnesses = []
    for circle_px in (0.0, 5.0, 9.0, 14.0, 22.0):
        image = fired(seen(bench(circle_px=circle_px), pan=pan), level_percent=level_percent)
        sharpnesses.append(sharpness(image, find_beam(image).lit))
    first = 1 if level_percent < 50 else 0  # in dim light, sharp edges and a little blur look alike
    steps = np.diff(sharpnesses[first:])
    assert (steps < 0.002).all(), sharpnesses
    assert sharpnesses[-1] < 0.6 * sharpnesses[0]


def test_a_flat_image_has_neither_blur_nor_contrast():
    flat = np.ones((720, 1280), np.float32)
    beam = find_beam(flat)
    assert sharpness(flat, beam.lit) == 0.0
    assert contrast(flat, beam.lit) == 0.0
    assert blur_circle(flat, grid_of(bench()), TARGET) is None
    dark = np.zeros((720, 1280), np.float32)
    assert sharpness(dark, find_beam(dark).lit) is None
    assert contrast(dark, find_beam(dark).lit) is None


def test_a_tag_out_of_the_frame_gives_no_blur_circle():
    truth = bench()
    assert blur_circle(fired(seen(truth, pan=14.0)), grid_of(truth, pan=14.0), TARGET) is None


def test_noise_is_not_taken_for_the_print():
    noise = np.random.default_rng(1).normal(size=(720, 1280)).astype(np.float32)
    assert blur_circle(noise, grid_of(bench()), TARGET) is None


def test_contrast_of_a_photograph():
    share = seen(bench())
    image = (10.0 + 90.0 * np.clip(share, 0.0, 1.0)).astype(np.float32)
    assert contrast(image, np.ones((9, 16), np.uint8)) == pytest.approx((100 - 10) / (100 + 10), abs=0.03)

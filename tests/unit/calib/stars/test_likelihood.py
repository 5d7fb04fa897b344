"""Likelihood locates stars in black and white images better than symmetry does, in any direction of the edges."""

import cv2
import numpy as np
import pytest
from slow_cases import slow

from calib.stars import likelihood as star_likelihood
from calib.stars.centring import SYMMETRY_REACH, LocalMap, refine_by_symmetry, smooth, symmetry_samples
from calib.stars.edge_pixels import LEVELS, quantise
from calib.stars.likelihood import refine_by_likelihood
from calib.stars.printed_star import blurred_edge_map, render_star
from calib.target import StarTarget

TARGET = StarTarget()
PITCH = 44.0


def stars(roll_deg, *, columns=11, rows=8, size=(760, 620), seed=0, fall_off=False):
    """Return a black and white image of a patch of stars, their centres and the map around them."""
    angle = np.deg2rad(roll_deg)
    turn = PITCH * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    fine = 5
    steps = (np.arange(fine) + 0.5) / fine - 0.5
    x = (np.arange(size[0])[:, None] + steps).ravel()
    y = (np.arange(size[1])[:, None] + steps).ravel()
    middle = np.array([size[0] / 2 + 0.21, size[1] / 2 - 0.33])
    on_grid = np.linalg.inv(turn) @ (np.stack(np.meshgrid(x, y)).reshape(2, -1) - middle[:, None])
    mm = (on_grid + np.array([[10.0], [12.0]])) * TARGET.pitch_mm
    value = TARGET.reflectance(mm[0], mm[1]).reshape(size[1], fine, size[0], fine).mean(axis=(1, 3))
    value = cv2.GaussianBlur(value, (0, 0), 0.7)
    if fall_off:  # to a fifth over the last three pitches
        value = value * np.interp(np.arange(size[0]), [580, 720], [1.0, 0.2])
    rng = np.random.default_rng(seed)
    fired = (value > 0.05 * np.exp(0.12 * rng.standard_normal(value.shape))).astype(np.float32)
    places = np.arange(columns) - columns // 2, np.arange(rows) - rows // 2
    grid = np.stack(np.meshgrid(*places)).reshape(2, -1)
    centres = (turn @ grid).T + middle
    inside = (centres > 40).all(axis=1) & (centres < np.array(size) - 41).all(axis=1)
    n = int(inside.sum())
    return fired, centres[inside], LocalMap(np.tile(turn, (n, 1, 1)), np.zeros((n, 2, 3)))


def rms(points, centres):
    return float(np.sqrt(((points - centres) ** 2).mean()))


@pytest.mark.parametrize("roll", [slow(0.4), 17.0])
def test_likelihood_beats_symmetry_in_black_and_white_images(roll):
    image, centres, shape = stars(roll, columns=7, rows=6, size=(520, 430))
    whole = np.full((len(centres), 2), SYMMETRY_REACH)
    fit = refine_by_symmetry(smooth(image, 1.0), centres, shape, symmetry_samples(PITCH), whole, 3.0)
    by_symmetry = fit.centres
    likely = refine_by_likelihood(quantise(image), by_symmetry, shape, TARGET)
    assert rms(likely.centres, centres) < 0.85 * rms(by_symmetry, centres)
    assert rms(likely.centres, centres) < 0.03


@pytest.mark.slow
def test_edges_along_the_pixel_grid_have_less_weight(monkeypatch):
    image, centres, shape = stars(0.4)
    start = centres + 0.03 * np.random.default_rng(5).standard_normal(centres.shape)
    weighted = refine_by_likelihood(quantise(image), start, shape, TARGET)
    none = np.ones(TARGET.segments)
    monkeypatch.setattr(star_likelihood, "overdispersion_of_edges", lambda *_: none)
    alike = refine_by_likelihood(quantise(image), start, shape, TARGET)
    assert rms(weighted.centres, centres) < 0.92 * rms(alike.centres, centres)


@pytest.mark.slow
def test_light_that_falls_off_across_a_star_is_measured_and_shifts_it_little():
    image, centres, shape = stars(17.0, fall_off=True)
    likely = refine_by_likelihood(quantise(image), centres, shape, TARGET)
    steep = centres[:, 0] > 600
    assert np.median(likely.light_slope[steep]) > 2 * np.median(likely.light_slope[~steep])
    assert np.abs(np.mean(likely.centres[steep] - centres[steep], axis=0)).max() < 0.02


@pytest.mark.parametrize(("values", "levels"), [(2, 2), (5, 5), (LEVELS, LEVELS), (1000, LEVELS)])
def test_levels_keep_the_order_of_brightness(values, levels):
    image = np.random.default_rng(4).integers(0, values, (200, 300)) * 0.25
    quantised = quantise(image)
    assert quantised.max() + 1 == levels
    order = np.argsort(image, axis=None, kind="stable")
    assert (np.diff(quantised.ravel()[order].astype(int)) >= 0).all()


def test_the_edge_map_of_a_star_is_point_symmetric():
    drawn = blurred_edge_map(render_star(TARGET, 30.0), TARGET.segments, 30.0, 0.75)
    assert np.abs(drawn.tau - drawn.tau[::-1, ::-1]).max() < 1e-6
    assert drawn.tau.min() < -1.0
    assert drawn.tau.max() > 1.0
    assert drawn.edge.max() == TARGET.segments - 1


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.float16, np.int32])
def test_each_level_of_an_image_of_many_values_holds_an_equal_share_of_it(kind: type) -> None:
    image = np.random.default_rng(4).permutation(64 * 90).reshape(64, 90).astype(kind)
    assert abs(np.bincount(quantise(image).ravel()) - 90).max() <= 4

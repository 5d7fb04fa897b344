"""Focus, aperture and breathing of the lens, against rays traced through a thin lens by this test alone."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators.config import bench_config
from simulators.optics.lens_focus import (
    blur_px,
    brightness,
    camera_of,
    reach_px,
    ring_deg,
    spread_over_disc,
    truth_record,
    with_ring_at,
)
from simulators.optics.picture import project, projection_of, true_rotation
from simulators.optics.scene import picture
from simulators.world.truth import CameraTruth, CollimatorTruth, LensTruth, MountTruth, OpticsTruth, Truth

PIXEL_MM = 4.86e-3
SMALL = {"fx": 1672.0, "fy": 1672.0, "cx": 159.5, "cy": 119.5, "width": 320, "height": 240, "k1": 0, "k2": 0}
LEVEL = {"mounting_deg": [0.0, 0.0, 0.0]}


def truth_of(**lens):
    """Truth of a bench without distortion and without errors of the collimator."""
    return bench_config({"camera": {"k1": 0, "k2": 0}, "optics": LEVEL, "lens": lens}).truth


def traced(focal_mm, image_mm, f_number, *, tangent=0.0, distance_mm=math.inf):
    """Where rays of a point meet the sensor, px from the axis, for (N, 2) points of the aperture.

    A paraxial ray at height h with slope u leaves a thin lens with the slope u - h / f.
    """
    turn = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    radius = 0.5 * focal_mm / f_number * np.sqrt((np.arange(40) + 0.5) / 40)
    edge = 0.5 * focal_mm / f_number
    r = np.concatenate([np.repeat(radius, turn.size), np.full(turn.size, edge)])
    at = np.column_stack([r * np.cos(np.resize(turn, r.size)), r * np.sin(np.resize(turn, r.size))])
    slope = np.full_like(at, 0.0)
    slope[:, 0] = tangent
    slope += at / distance_mm  # a point at that distance, seen from the middle of the lens under the tangent
    return (at + image_mm * (slope - at / focal_mm)) / PIXEL_MM


@pytest.mark.parametrize("distance_m", [0.3, 1.0, 2.7, 10.0, -5.0])
@pytest.mark.parametrize("f_number", [1.4, 2.8, 8.0])
def test_blur_and_breathing_are_those_of_traced_rays(distance_m, f_number):
    truth = truth_of(focus_distance_m=distance_m, f_number=f_number)
    focal_mm = 0.5 * (truth.camera.fx + truth.camera.fy) * PIXEL_MM
    image_mm = 1.0 / (1.0 / focal_mm - 1.0 / (1e3 * distance_m))  # where rays of that distance meet
    sharp = traced(focal_mm, image_mm, f_number, distance_mm=1e3 * distance_m)
    assert np.abs(sharp).max() < 1e-9
    tangent = 0.1
    hits = traced(focal_mm, image_mm, f_number, tangent=tangent)
    # The pattern is at infinity, so the light of one of its points fills a disc around the ray through the middle.
    assert blur_px(truth) == pytest.approx(np.ptp(hits, axis=0).max(), rel=0.01)
    seen_px = hits[:, 0].mean() * truth.camera.fx / 3345.165
    assert camera_of(truth).fx * tangent == pytest.approx(seen_px, rel=1e-4)
    c = truth.collimator
    point = np.array([[c.x + c.r * tangent, c.y]])
    seen = project(point, true_rotation({}, truth), truth)
    assert seen[0, 0] - truth.camera.cx == pytest.approx(seen_px, rel=1e-6)


def test_the_profile_of_a_blurred_edge_is_that_of_traced_rays():
    truth = bench_config({"camera": SMALL, "optics": LEVEL, "lens": {"focus_distance_m": 1.0}}).truth
    blur = blur_px(truth)
    assert blur > 4.0
    focal_mm = 1672.0 * PIXEL_MM
    image_mm = 1.0 / (1.0 / focal_mm - 1e-3)
    hits = traced(focal_mm, image_mm, 2.8)[:960, 0]
    margin = reach_px(blur)
    columns = np.arange(-margin, 60 + margin)
    edge = np.broadcast_to((columns >= 30).astype(np.float32), (41 + 2 * margin, columns.size))
    row = spread_over_disc(np.ascontiguousarray(edge), blur)[20]
    # A pixel holds the mean over its own width of an edge at 29.5 that each ray displaces by its own hit.
    at = np.arange(60)[:, None] - 29.5
    expected = np.clip(at - hits[None, :] + 0.5, 0.0, 1.0).mean(axis=1)
    np.testing.assert_allclose(row, expected, atol=0.02)
    assert row[30] - row[29] == pytest.approx(4.0 / (np.pi * blur), rel=0.1)  # middle of an even disc's edge


@given(st.sampled_from(["ideal", "like-bench", "S1"]), st.floats(-10.0, 180.0))
def test_the_ring_stands_where_it_was_turned_to(collimator, angle):
    truth = bench_config({"collimator": collimator}).truth
    turned = replace(truth, lens=with_ring_at(truth, angle))
    assert ring_deg(turned) == pytest.approx(angle, abs=0.5 if angle < -9.0 else 1e-6)


def test_focused_on_the_pattern_the_image_is_as_delivered():
    for collimator, distance in (("ideal", "infinity"), ("like-bench", 0.255 / 0.066)):
        delivered = bench_config({"camera": SMALL, "collimator": collimator}).truth
        focused = replace(delivered, lens=bench_config({"lens": {"focus_distance_m": distance}}).truth.lens)
        assert blur_px(focused) < 1e-9
        assert camera_of(focused).fx == pytest.approx(delivered.camera.fx, rel=1e-12)
        np.testing.assert_allclose(picture(focused, {}), picture(delivered, {}), atol=1e-6)


def test_closing_the_aperture_sharpens_and_darkens():
    wide, small = truth_of(focus_distance_m=1.0), truth_of(focus_distance_m=1.0, f_number=5.6)
    assert blur_px(small) == pytest.approx(blur_px(wide) / 2)
    assert brightness(small) == pytest.approx(brightness(wide) / 4)
    camera, pose = SMALL, {"pan": 0.5}
    light, dark = (bench_config({"camera": camera, "lens": {"f_number": n}}).truth for n in (2.8, 5.6))
    np.testing.assert_allclose(picture(dark, pose), picture(light, pose) / 4, rtol=1e-6)


def test_every_word_for_infinity_means_the_same():
    for word in ("infinity", "Infinity", ".inf", math.inf, -math.inf):
        assert bench_config({"lens": {"focus_distance_m": word}}).truth.lens.focus_distance_m == math.inf
    assert bench_config({"lens": {"focus_distance_m": "pattern"}}).truth.lens == LensTruth()


def test_the_truth_file_has_strict_numbers():
    for lens in ({}, {"focus_distance_m": "infinity"}, {"focus_distance_m": 1.0}):
        record = truth_record(bench_config({"lens": lens}).truth)
        lens_record = json.loads(json.dumps(record, allow_nan=False))["lens"]
        expected_px = 19.74 if lens.get("focus_distance_m") == 1.0 else 0.0
        assert lens_record["blur_px"] == pytest.approx(expected_px, abs=0.01)


def test_a_camera_turned_in_its_mount_sees_the_target_turned():
    truth = Truth(CameraTruth(k1=0.0, k2=0.0), CollimatorTruth(), OpticsTruth(mounting_deg=(0.0, 0.0, 0.0)))
    rolled = replace(truth, mount=MountTruth(turn_deg=(0.0, 0.0, 10.0)))
    tipped = replace(truth, mount=MountTruth(turn_deg=(3.0, -2.0, 0.0)))
    np.testing.assert_allclose(true_rotation({}, rolled), true_rotation({"roll": 10.0}, truth), atol=1e-12)
    expected = true_rotation({"pan": 3.0, "tilt": -2.0}, truth)
    np.testing.assert_allclose(true_rotation({}, tipped), expected, atol=1e-12)
    # the mount is turned after the axes: a roll in it also turns the directions in which pan and tilt move the image
    wrong = true_rotation({"pan": 3.0}, rolled) - true_rotation({"pan": 3.0, "roll": 10.0}, truth)
    assert np.abs(wrong).max() < 1e-12
    assert projection_of(rolled, true_rotation({}, rolled)).rotation.shape == (3, 3)

"""Boards at finite distance: their blur and their places, against rays that this test traces through a thick lens."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from simulators.config import bench_config
from simulators.optics import scene
from simulators.optics.board_scene import blur_of, placed_boards
from simulators.optics.outlines import points_mm
from simulators.world.board import BoardState

PIXEL_MM = 4.86e-3
CAMERA = {"fx": 3300.0, "fy": 3300.0, "cx": 320.0, "cy": 239.0, "width": 640, "height": 480, "k1": 0, "k2": 0}
NEAR = {"position_mm": [3, -2, 420], "turn_deg": [24, -31, 12]}
DOTS = {"kind": "circles", "surface": "leds", "columns": 5, "rows": 4, "pitch_mm": 12, "dot_mm": 1.0}


def truth_of(board, lens=None, **sections):
    """Truth of a bench with a board."""
    sections = {"camera": CAMERA, **sections}
    return bench_config({"board": board, "lens": lens or {}, **sections}).truth_for(1)


class ThickLens:
    """A biconvex lens of glass, 6 mm thick, through which paraxial rays are traced from surface to surface.

    Its principal planes are found by tracing too. The stop is the first principal plane, as a thin lens has it.
    """

    def __init__(self, focal_mm):
        self.index, self.thick = 1.62, 6.0
        low, high = 0.2 * focal_mm, 5.0 * focal_mm
        for _ in range(200):  # radius of both surfaces, by bisection on the focal length that rays show
            self.radius = 0.5 * (low + high)
            if self._focal_mm() > focal_mm:
                high = self.radius
            else:
                low = self.radius
        height, slope = self.trace(1.0, 0.0)
        # The ray would have bent at once that far before the second surface; and, as the lens is symmetric, the first
        # principal plane lies that far behind the first surface.
        self.depth = (height - 1.0) / slope

    def _focal_mm(self):
        return -1.0 / self.trace(1.0, 0.0)[1]

    def trace(self, height, slope):
        """Height and slope behind the last surface, of a ray that meets the first one: Snell's law for small angles."""
        inside = (slope - height * (self.index - 1.0) / self.radius) / self.index
        height = height + self.thick * inside
        return height, self.index * inside + height * (1.0 - self.index) / self.radius

    def on_sensor(self, point_mm, stop_mm, image_mm):
        """Where rays of points meet a sensor ``image_mm`` behind the second principal plane, mm.

        ``point_mm`` (..., 3) lies before the first principal plane; ``stop_mm`` (..., 2) is the ray's place there.
        """
        slope = (stop_mm - point_mm[..., :2]) / point_mm[..., 2:]
        at_surface = stop_mm - self.depth * slope
        height, slope = self.trace(at_surface, slope)
        return height + (image_mm - self.depth) * slope


def stop_points(diameter_mm, rings=24, spokes=48):
    """Points that fill the stop evenly, and points of its edge, mm."""
    radius = 0.5 * diameter_mm * np.sqrt((np.arange(rings) + 0.5) / rings)
    angle = 2 * np.pi * np.arange(spokes) / spokes
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    return (radius[:, None, None] * ring).reshape(-1, 2), 0.5 * diameter_mm * ring


def traced(truth, points_mm):
    """Hits of the rays of points in the camera's frame, px: (N, rays, 2) of the whole stop, and of its edge."""
    focal_mm = (
        PIXEL_MM * CAMERA["fx"]
    )  # as stated: the lens at infinity has the focal length of section camera
    lens = ThickLens(focal_mm)
    focus_mm = 1e3 * truth.lens.focus_distance_m
    behind = lens.on_sensor(np.array([[0.0, 0.0, focus_mm]]), np.array([[1.0, 0.0]]), 0.0)[0, 0]
    ahead = lens.on_sensor(np.array([[0.0, 0.0, focus_mm]]), np.array([[1.0, 0.0]]), 1.0)[0, 0]
    image_mm = behind / (behind - ahead)  # where the rays of the plane in focus meet
    stops = stop_points(focal_mm / truth.lens.f_number)
    hits = (lens.on_sensor(points_mm[:, None], stop[None], image_mm) for stop in stops)
    return [
        np.array([CAMERA["cx"], CAMERA["cy"]]) - one / PIXEL_MM for one in hits
    ]  # the image is upside down


def in_camera(placed, points_mm):
    """Points of a board in the camera's frame."""
    return np.column_stack([points_mm, np.zeros(len(points_mm))]) @ placed.rotation.T + placed.position


@pytest.mark.parametrize("focus_m", [0.35, 0.42, 0.6, 2.0])
@pytest.mark.parametrize("f_number", [2.0, 4.0])
def test_points_of_a_tilted_near_board_lie_and_blur_as_traced_rays(focus_m, f_number):
    truth = truth_of({**DOTS, "placements": [NEAR]}, {"focus_distance_m": focus_m, "f_number": f_number})
    placed = placed_boards(truth, {})[0]
    points = points_mm(truth.board, truth.target)
    filled, edge = traced(truth, in_camera(placed, points))
    seen = scene.corners(truth, {})
    assert np.abs(filled.mean(axis=1) - seen).max() < 0.01
    diameters = np.ptp(edge, axis=1).mean(axis=1)
    blur = blur_of(truth, placed)
    margin = (blur.map_px.shape[1] - CAMERA["width"]) // 2
    column, row = np.rint(seen).astype(int).T + margin
    at = blur.map_px[row, column]
    assert (np.abs(at - diameters) < np.maximum(0.01 * diameters, 0.02)).all()


def test_dots_of_the_rendered_picture_lie_and_blur_as_traced_rays():
    lens = {"focus_distance_m": 0.35, "f_number": 2.0}
    truth = truth_of({**DOTS, "placements": [NEAR]}, lens, optics={"psf_px": 0.7, "mounting_deg": [0, 0, 7]})
    image = scene.picture(truth, {}).astype(float)
    placed = placed_boards(truth, {})[0]
    dot, _ = stop_points(DOTS["dot_mm"], rings=8, spokes=24)
    v, u = np.mgrid[: CAMERA["height"], : CAMERA["width"]]
    for point, seen in zip(points_mm(truth.board, truth.target), scene.corners(truth, {}), strict=True):
        hits = traced(truth, in_camera(placed, point + dot))[0].reshape(-1, 2)
        near = np.hypot(u - seen[0], v - seen[1]) < 45
        weight = image[near] / image[near].sum()
        at = np.column_stack([u[near], v[near]])
        centre = weight @ at
        assert np.abs(centre - hits.mean(axis=0)).max() < 0.01
        spread = math.sqrt(weight @ ((at - centre) ** 2).sum(axis=1))
        own = hits.var(axis=0).sum() + 2 * (0.7**2 + 1.0 / 12.0)  # with point spread and the pixel's own area
        assert spread == pytest.approx(math.sqrt(own), rel=0.01)


@pytest.mark.parametrize("kind", ["checkerboard", "circles", "asymmetric-circles", "blinking-dots", "stars"])
def test_the_points_lie_where_opencv_projects_them(kind):
    board = {"kind": kind, "placements": [NEAR]}
    if kind != "stars":
        board |= {"columns": 4, "rows": 5, "pitch_mm": 8}
    truth = truth_of(board, camera={**CAMERA, "k1": 0.1, "k2": -0.4})
    points = points_mm(truth.board, truth.target)
    middle = truth.target.tag_centre_mm if kind == "stars" else 0.5 * (points.min(0) + points.max(0))
    around = np.column_stack([points - middle, np.zeros(len(points))])
    matrix = np.array([[CAMERA["fx"], 0, CAMERA["cx"]], [0, CAMERA["fy"], CAMERA["cy"]], [0, 0, 1.0]])
    turn, place = np.radians(NEAR["turn_deg"]), np.array(NEAR["position_mm"], float)
    expected, _ = cv2.projectPoints(around, turn, place, matrix, np.array([0.1, -0.4, 0.0, 0.0]))
    np.testing.assert_allclose(scene.corners(truth, {}), expected.reshape(-1, 2), atol=1e-6)


def grid_share(pixel_mm, fill, psf_px=0.7):
    """Contrast that the grid of a screen's pixels leaves in the middle of a bright square, and the mean light."""
    board = {"kind": "checkerboard", "columns": 2, "rows": 2, "pitch_mm": 24, "pixel_mm": pixel_mm, "fill": fill,
             "placements": [{"position_mm": [0, 0, 600]}]}  # fmt: skip
    image = scene.picture(truth_of(board, optics={"psf_px": psf_px, "mounting_deg": [0, 0, 0]}), {})
    middle = image[239 - 20 : 239 + 20, 320 - 20 : 320 + 20]
    return float(np.ptp(middle)), float(middle.mean())


def test_the_pixels_of_a_screen_are_seen_if_they_are_large():
    fine, light = grid_share(0.2, 0.6)  # 1.1 px of the camera
    assert fine < 1e-3
    assert light == pytest.approx(0.6, abs=1e-3)
    coarse, light = grid_share(1.0, 0.6)  # 5.5 px
    assert coarse > 0.2
    assert light == pytest.approx(0.6, abs=0.05)
    assert grid_share(1.0, 1.0)[0] < 1e-5


def test_a_print_is_white_around_its_marks_and_a_screen_is_dark():
    board = {"kind": "checkerboard", "columns": 3, "rows": 3, "pitch_mm": 10, "placements": [NEAR]}
    screen, printed = (scene.picture(truth_of({**board, "surface": s}), {}) for s in ("screen", "print"))
    middle = (slice(200, 280), slice(280, 360))
    np.testing.assert_allclose(screen[middle], 1.0 - (printed[middle] - 0.04) / 0.96, atol=1e-3)
    assert screen.min() == 0.0
    assert printed.min() == pytest.approx(0.04)


def test_a_second_board_stands_beside_the_first():
    board = {**DOTS, "rows": 2}
    truth = truth_of({**board, "placements": [{**NEAR, "second_mm": [0, 24, 5]}]})
    alone = truth_of({**board, "placements": [NEAR]})
    both, one = scene.picture(truth, {}), scene.picture(alone, {})
    assert (both >= one - 1e-6).all()
    assert both.sum() > 1.2 * one.sum()
    state = BoardState(second_mm=(0.0, 24.0, 5.0))
    np.testing.assert_array_equal(both, scene.picture(replace(alone, board=alone.board.in_state(state)), {}))


def test_parts_behind_the_camera_are_not_seen():
    truth = truth_of({**DOTS, "placements": [{"position_mm": [0, 0, 100]}]})
    behind = replace(truth, board=truth.board.in_state(BoardState(move_mm=(0.0, 0.0, -300.0))))
    assert scene.picture(behind, {}).max() == 0.0

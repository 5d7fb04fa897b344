"""Cameras from straight edges, a benchmark: the adjustment, and edges in events."""

import numpy as np
import pytest

from calib.model.camera import CameraModel
from calib.model.rotation import exp_map
from tests.benchmarks.compared.by_lines import SeenEdges, calibrate_by_lines
from tests.benchmarks.compared.line_events import EdgePoints, edge_points

SIZE = (1280, 720)
TRUE = CameraModel(3345.06, 3347.27, 642.1, 363.32, SIZE, {"k1": 0.06, "k2": -0.9})
SHEET = np.array([[-148.5, -105.0, 0.0], [148.5, -105.0, 0.0], [148.5, 105.0, 0.0], [-148.5, 105.0, 0.0]])
SHEET_EDGES = np.stack([SHEET, np.roll(SHEET, -1, axis=0)], axis=1)


def seen_sheet(number, turn, shift, widened_px=0.0):
    """Points along the edges through the true lens, moved to the dark outside."""
    edges = []
    for first, second in SHEET_EDGES:
        along = np.linspace(0.1, 0.9, 9)[:, None]
        points = TRUE.project((first + along * (second - first)) @ exp_map(turn).T + shift)
        middle = TRUE.project(shift[None])[0]
        across = points[-1] - points[0]
        across = np.array([-across[1], across[0]]) / np.hypot(*across)
        darkwards = across * np.sign(across @ (points[4] - middle))
        edges.append(EdgePoints(points + widened_px * darkwards, darkwards, np.full(9, 0.02)))
    return SeenEdges(f"pass {number}", SHEET_EDGES, tuple(edges))


def many_poses():
    rng = np.random.default_rng(3)
    return [(rng.normal(0, 0.4, 3), np.array([*rng.uniform(-90, 90, 2), 1800.0])) for _ in range(12)]


def test_edges_of_a_sheet_give_the_camera_that_saw_them():
    views = [seen_sheet(number, *pose) for number, pose in enumerate(many_poses())]
    calibration = calibrate_by_lines(views, SIZE)
    assert calibration.camera.fx == pytest.approx(TRUE.fx, abs=0.01)
    assert calibration.camera.cy == pytest.approx(TRUE.cy, abs=0.01)
    assert calibration.camera.distortion["k2"] == pytest.approx(-0.9, abs=1e-3)
    assert calibration.rms_px < 1e-4


def test_a_sheet_that_looks_larger_than_it_is_gives_the_right_camera_if_this_is_estimated():
    views = [seen_sheet(number, *pose, widened_px=0.3) for number, pose in enumerate(many_poses())]
    wrong, right = (calibrate_by_lines(views, SIZE, widened=widened) for widened in (False, True))
    assert abs(right.camera.fx - TRUE.fx) < 0.05
    assert abs(wrong.camera.fx - TRUE.fx) > 10 * abs(right.camera.fx - TRUE.fx)


def swept_edge(rng, *, brighter, speed_px_ms=0.8, noise=400):
    """Events of an edge along x at y = 300 + 0.1 (x - 400), at time 15 ms, that moves down; and noise."""
    count = 4000
    t = rng.uniform(0, 30_000, count)
    x = rng.integers(300, 700, count)
    y = np.round(300 + 0.1 * (x - 400) + speed_px_ms * 1e-3 * (t - 15_000) + 0.5 * rng.normal(size=count))
    p = np.full(count, int(brighter))
    stray = rng.integers([0, 300, 260, 0], [30_000, 700, 340, 2], size=(noise, 4)).T
    return tuple(np.concatenate(both) for both in zip((t, x, y, p), stray, strict=True))


@pytest.mark.parametrize("brighter", [True, False])
def test_an_edge_is_found_where_it_is_at_the_time_of_the_picture(brighter):
    rng = np.random.default_rng(1)
    marked = np.array([[304.0, 288.0], [696.0, 332.0]])
    edge = edge_points(swept_edge(rng, brighter=brighter), 15_000.0, marked, rng)
    x, y = edge.points_px.T
    assert np.abs(y - (300 + 0.1 * (x - 400))).max() < 0.15
    # It moves down: if pixels get brighter, the dark side is below.
    assert (edge.darkwards[1] > 0) == brighter

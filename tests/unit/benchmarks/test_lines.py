"""Cameras from straight edges, a benchmark: closed forms, the adjustment, and edges in events."""

import numpy as np
import pytest
from box_scene import ShownBox

from calib.errors import DegenerateViews, TargetNotFound
from calib.model.camera import CameraModel
from calib.model.closed_forms import zhang_matrix
from calib.model.rotation import exp_map
from tests.benchmarks.compared.by_lines import SeenEdges, calibrate_by_lines
from tests.benchmarks.compared.line_events import EdgePoints, edge_points
from tests.benchmarks.compared.line_geometry import camera_of_projection, projection_of_lines

SIZE = (1280, 720)
PINHOLE = CameraModel(3345.06, 3347.27, 642.1, 363.32, SIZE)
TRUE = CameraModel(3345.06, 3347.27, 642.1, 363.32, SIZE, {"k1": 0.06, "k2": -0.9})
SHEET = np.array([[-148.5, -105.0, 0.0], [148.5, -105.0, 0.0], [148.5, 105.0, 0.0], [-148.5, 105.0, 0.0]])
SHEET_EDGES = np.stack([SHEET, np.roll(SHEET, -1, axis=0)], axis=1)
INSIDE = np.zeros(3)
POSES = [
    (np.array(turn), np.array([x, y, 1800.0]))
    for turn, x, y in (((0.5, 0.1, 0.3), 60, 20), ((-0.4, 0.5, 1.2), -80, -30), ((0.1, -0.6, -0.7), 0, 40))
]

BOX_POSES = [
    (np.array([0.5, sign * 0.6, roll]), shift)
    for (_, shift), sign, roll in zip(POSES, (1, -1, 1), (0.1, 0.3, -0.2), strict=True)
]


def line_through(camera, ends_mm, turn, shift):
    first, second = (camera.matrix @ (exp_map(turn) @ end + shift) for end in ends_mm)
    line = np.cross(first, second)
    return line / np.hypot(*line[:2])


def test_four_lines_of_a_sheet_give_the_homography_of_a_noiseless_view():
    homographies = []
    for turn, shift in POSES:
        lines = np.array([line_through(PINHOLE, ends, turn, shift) for ends in SHEET_EDGES])
        homography = projection_of_lines(lines, SHEET_EDGES)
        true = PINHOLE.matrix @ np.column_stack([exp_map(turn)[:, :2], shift])
        assert np.allclose(homography / homography[2, 2], true / true[2, 2], rtol=1e-9, atol=1e-9)
        homographies.append(homography)
    matrix = zhang_matrix(np.array(homographies), SIZE, free_principal_point=True)
    assert np.allclose(matrix, PINHOLE.matrix, rtol=1e-9)


def test_lines_of_a_box_give_camera_and_pose_of_one_noiseless_view():
    for turn, shift in BOX_POSES:
        box = ShownBox(180.0, 130.0, 150.0, tuple(shift), tuple(np.degrees(turn)))
        ends = box.edges_mm()
        assert len(ends) == 9  # three faces are seen
        lines = np.array([line_through(PINHOLE, edge, turn, shift) for edge in ends])
        for chosen in (slice(None), [0, 1, 2, 4, 5, 6, 8]):
            projection = projection_of_lines(lines[chosen], ends[chosen])
            matrix, rotation, translation = camera_of_projection(projection, np.array([0.0, 0.0, 75.0]))
            assert np.allclose(matrix, PINHOLE.matrix, rtol=1e-9, atol=1e-6)
            assert np.allclose(rotation, exp_map(turn), atol=1e-9)
            assert np.allclose(translation, shift, rtol=1e-9, atol=1e-6)


def test_too_few_lines_are_refused():
    lines = np.array([line_through(PINHOLE, ends, *POSES[0]) for ends in SHEET_EDGES])
    with pytest.raises(DegenerateViews, match="3 lines; 4 are needed"):
        projection_of_lines(lines[:3], SHEET_EDGES[:3])
    in_space = SHEET_EDGES + np.array([0.0, 0.0, 1.0])
    with pytest.raises(DegenerateViews, match="4 lines; 6 are needed"):
        projection_of_lines(lines, in_space)


def seen_sheet(number, turn, shift, widened_px=0.0):
    """Points along the edges through the true lens, moved to the dark outside."""
    edges = []
    for first, second in SHEET_EDGES:
        along = np.linspace(0.1, 0.9, 9)[:, None]
        points = TRUE.project((first + along * (second - first)) @ exp_map(turn).T + shift)
        middle = TRUE.project((exp_map(turn) @ INSIDE + shift)[None])[0]
        across = points[-1] - points[0]
        across = np.array([-across[1], across[0]]) / np.hypot(*across)
        darkwards = across * np.sign(across @ (points[4] - middle))
        edges.append(EdgePoints(points + widened_px * darkwards, darkwards, np.full(9, 0.02)))
    return SeenEdges(f"pass {number}", SHEET_EDGES, INSIDE, tuple(edges))


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


def test_an_edge_that_was_taken_for_another_does_not_spoil_the_camera():
    views = [seen_sheet(number, *pose) for number, pose in enumerate(many_poses())]
    first = views[0].edges[0]
    mistaken = EdgePoints(first.points_px + 4.0 * first.darkwards, first.darkwards, first.sigma_px)
    views[0] = SeenEdges("pass 0", SHEET_EDGES, INSIDE, (mistaken, *views[0].edges[1:]))
    assert calibrate_by_lines(views, SIZE).camera.fx == pytest.approx(TRUE.fx, abs=0.05)


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


def test_an_edge_without_events_is_refused():
    rng = np.random.default_rng(1)
    marked = np.array([[304.0, 588.0], [696.0, 632.0]])
    with pytest.raises(TargetNotFound, match="edge"):
        edge_points(swept_edge(rng, brighter=True), 15_000.0, marked, rng)

"""The star target: numbering, geometry and print."""

import cv2
import numpy as np
import pytest
from slow_cases import slow

from calib.errors import InputMismatch
from calib.target import TAG_FAMILIES, StarTarget

TARGET = StarTarget()


def test_ids_count_row_by_row_over_the_stars_that_exist():
    nodes = TARGET.node_of(TARGET.ids)
    column, row = nodes[:, 0], nodes[:, 1]
    # The rule of the published recordings: 5 fewer for each tag row passed, 25 fewer below the tag.
    passed = np.clip(row - 33, 0, 5) + ((row >= 33) & (row < 38) & (column > 26))
    assert np.array_equal(TARGET.ids, column + 49 * row - 5 * passed)
    assert len(TARGET.ids) == 49 * 71 - 25


def test_id_at_inverts_node_of_and_knows_no_star_under_the_tag_or_outside():
    nodes = TARGET.node_of(TARGET.ids)
    assert np.array_equal(TARGET.id_at(nodes[:, 0], nodes[:, 1]), TARGET.ids)
    assert (TARGET.id_at([22, 26, 24, -1, 49, 0, 0], [33, 37, 35, 0, 0, -1, 71]) == -1).all()
    assert (TARGET.id_at([21, 27], [33, 37]) >= 0).all()


def test_positions_are_multiples_of_the_pitch():
    assert TARGET.positions_mm([903])[0] == pytest.approx([21 * 144.5 / 36, 18 * 144.5 / 36])
    assert TARGET.tag_centre_mm == pytest.approx((24 * 144.5 / 36, 35 * 144.5 / 36))


@pytest.mark.parametrize("ids", [[-1], [3454]])
def test_an_unknown_star_is_refused(ids):
    with pytest.raises(InputMismatch, match="not on the target"):
        TARGET.positions_mm(ids)


@pytest.mark.parametrize(
    "change",
    [
        {"squares_x": 1},
        {"pitch_mm": 0.0},
        {"pitch_mm": float("nan")},
        {"segments": 6},
        {"tag_id": 587},
        {"tag_square": (0, 3)},
        {"tag_square": (46, 3)},
        {"tag_squares": 0},
        {"tag_family": "36h12"},
        {"tag_family": "16h5", "tag_id": 30},
    ],
)
def test_an_unprintable_target_is_refused(change):
    with pytest.raises(InputMismatch):
        StarTarget(**change)


def test_a_star_looks_the_same_after_half_a_turn_and_inverted_after_one_segment():
    rng = np.random.default_rng(1)
    radius, angle = 0.45 * TARGET.pitch_mm, rng.uniform(0, 2 * np.pi, 2000)
    x0, y0 = TARGET.positions_mm([0])[0] + 3 * TARGET.pitch_mm

    def around(turn):
        return TARGET.reflectance(x0 + radius * np.cos(angle + turn), y0 + radius * np.sin(angle + turn))

    assert np.array_equal(around(0.0), around(np.pi))
    assert np.array_equal(around(0.0), 1.0 - around(2 * np.pi / 16))
    assert around(0.0).mean() == pytest.approx(0.5, abs=0.05)


def test_the_segment_that_begins_at_plus_y_is_white():
    angle = np.deg2rad(90 + 22.5 * np.arange(16) + 11.25)
    values = TARGET.reflectance(1.5 * np.cos(angle) + 2 * TARGET.pitch_mm, 1.5 * np.sin(angle))
    assert np.array_equal(values, [1.0, 0.0] * 8)


def test_paper_around_the_tag_and_outside_the_stars_is_white():
    pitch = TARGET.pitch_mm
    along = np.linspace(21.51, 26.49, 97) * pitch
    ring = [(along, 32.75 * pitch), (along, 37.25 * pitch), (21.75 * pitch, along + 11 * pitch)]
    assert all((TARGET.reflectance(x, y) == 1.0).all() for x, y in ring)
    assert (TARGET.reflectance([-0.51 * pitch, 48.51 * pitch], [0.0, 0.0]) == 1.0).all()


@pytest.mark.parametrize("name", TAG_FAMILIES)
def test_the_families_of_tags_are_those_of_opencv(name):
    family = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_APRILTAG_{name}"))
    assert TAG_FAMILIES[name] == (family.markerSize + 2, len(family.bytesList))


@pytest.mark.parametrize(
    ("family_name", "tag_id"), [("36h11", 3), ("36h11", 586), slow("36h10", 2319), ("25h9", 1), ("16h5", 29)]
)
def test_opencv_reads_the_printed_tag_upright_and_not_mirrored(family_name, tag_id):
    target = StarTarget(tag_id=tag_id, tag_family=family_name)
    step_mm = target.pitch_mm / 40
    x = np.arange(16 * target.pitch_mm, 32 * target.pitch_mm, step_mm)
    y = np.arange(27 * target.pitch_mm, 43 * target.pitch_mm, step_mm)
    image = (255 * target.reflectance(x[None, :], y[:, None])).astype(np.uint8)
    family = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_APRILTAG_{family_name}"))
    detector = cv2.aruco.ArucoDetector(family)
    corners, ids, _ = detector.detectMarkers(image)
    assert ids.ravel().tolist() == [tag_id]
    found_mm = corners[0][0] * step_mm + [x[0], y[0]]
    assert np.abs(found_mm - target.tag_corners_mm).max() < 2 * step_mm
    assert detector.detectMarkers(image[:, ::-1].copy())[1] is None

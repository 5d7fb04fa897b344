"""Checkerboards and circles are found where they are, and what is wrong with an image is named."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.boards.board import Board
from calib.boards.detect import detect_board
from calib.errors import InputMismatch, TargetNotFound
from calib.model.homography import apply_homography

SIZE = (480, 300)
CHECKERBOARD = Board("checkerboard", 7, 5, 20.0)
#: From mm on the board to px: scale, turn and perspective.
PLACED = np.array([[1.9, 0.42, 88.0], [-0.25, 2.0, 60.0], [6e-4, 8e-4, 1.0]])


def brightness(board, x, y):
    """Brightness of places on the board's plane, mm; a bright margin lies around the board."""
    pitch = board.pitch_mm
    if board.kind == "checkerboard":
        inside = (x > -pitch) & (x < board.columns * pitch) & (y > -pitch) & (y < board.rows * pitch)
        dark = (np.floor(x / pitch) + np.floor(y / pitch)) % 2 == 0
        return np.where(inside & dark, 0.0, 1.0)
    step, odd = (2, 1) if board.kind == "asymmetric-circles" else (1, 0)
    row = np.clip(np.round(y / pitch), 0, board.rows - 1)
    column = np.clip(np.round((x / pitch - odd * (row % 2)) / step), 0, board.columns - 1)
    from_nearest = np.hypot(x - pitch * (step * column + odd * (row % 2)), y - pitch * row)
    return np.where(from_nearest < 0.3 * pitch, 0.0, 1.0)


def picture(board, h=PLACED, size=SIZE, cells=4):
    """The board as a camera without noise sees it: each pixel the mean of its cells, 0 to 1."""
    width, height = size
    steps = (np.arange(cells) + 0.5) / cells - 0.5
    v, u = np.meshgrid(np.arange(height), np.arange(width), indexing="ij")
    total = np.zeros((height, width))
    inverse = np.linalg.inv(h)
    for dv in steps:
        for du in steps:
            at = apply_homography(inverse, np.column_stack([(u + du).ravel(), (v + dv).ravel()]))
            total += brightness(board, at[:, 0], at[:, 1]).reshape(height, width)
    return total / cells**2


def error_px(view, board, h=PLACED):
    """(N, 2) errors of the points; a board may be numbered from its other end."""
    true = apply_homography(h, board.points_mm)
    return min(
        (view.points_px - order[view.ids] for order in (true, true[::-1])), key=lambda off: np.abs(off).max()
    )


@pytest.mark.parametrize(
    ("kind", "inverted"),
    [("checkerboard", False), ("circles", False), ("circles", True), ("asymmetric-circles", False)],
)
def test_points_lie_within_a_twentieth_of_a_pixel_of_the_truth(kind, inverted):
    board = Board(kind, 4, 7, 10.0) if kind == "asymmetric-circles" else Board(kind, 7, 5, 20.0)
    image = picture(board)
    view = detect_board(1.0 - image if inverted else image, board)
    error = error_px(view, board)
    assert len(view) == board.columns * board.rows
    assert np.abs(error).max() < 0.05
    assert np.sqrt((error**2).mean()) < 0.02


@pytest.mark.parametrize("described", [Board("circles", 4, 7, 10.0), Board("asymmetric-circles", 7, 4, 10.0)])
def test_circles_of_another_kind_or_with_rows_as_columns_are_named(described):
    """OpenCV's finder took the asymmetric grid for a symmetric one, whose map then asked for 29 GB."""
    with pytest.raises(TargetNotFound) as error:
        detect_board(picture(Board("asymmetric-circles", 4, 7, 10.0)), described)
    assert "shows 4 x 7 asymmetric circles" in error.value.remedy


def test_the_centre_of_a_circle_is_its_own_image_not_that_of_the_ellipse():
    board = Board("circles", 5, 4, 30.0)
    steep = np.array([[3.0, 0.0, 60.0], [0.0, 3.0, 60.0], [3.5e-3, 2.5e-3, 1.0]])
    image = picture(board, steep)
    error = error_px(detect_board(image, board), board, steep)
    assert np.abs(error).max() < 0.08
    # The biggest ellipse's centre of gravity lies three times as far off as any located point.
    at = apply_homography(steep, board.points_mm[:1])[0].round().astype(int)
    dark = 1.0 - image[at[1] - 30 : at[1] + 31, at[0] - 30 : at[0] + 31]
    v, u = np.indices(dark.shape)
    centre = np.array([(u * dark).sum(), (v * dark).sum()]) / dark.sum() + at - 30
    assert np.linalg.norm(centre - apply_homography(steep, board.points_mm[:1])[0]) > 0.25


@pytest.mark.slow
def test_stated_uncertainty_grows_with_the_noise_and_covers_the_errors():
    rng = np.random.default_rng(4)
    clean = picture(CHECKERBOARD)
    stated = []
    for sigma in (0.02, 0.1):
        view = detect_board(clean + rng.normal(0.0, sigma, clean.shape), CHECKERBOARD)
        common = 0.05**2  # what the image around a point does not show
        own = np.sqrt(np.trace(view.covariances_px2, axis1=1, axis2=2).mean() / 2 - common)
        assert 0.5 < np.sqrt((error_px(view, CHECKERBOARD) ** 2).mean()) / own < 2.0
        stated.append(own)
    assert stated[1] > 3 * stated[0]


@pytest.mark.parametrize("kind", ["checkerboard", "circles"])
def test_a_picture_out_of_focus_is_named_with_the_width_of_its_edges(kind):
    board = Board(kind, 7, 5, 20.0)
    picture_of = picture(board, cells=2)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (41, 41)).astype(np.float64)
    with pytest.raises(TargetNotFound, match=r"out of focus: .* [12][0-9] px"):
        detect_board(cv2.filter2D(picture_of, -1, disc / disc.sum()), board)


@pytest.mark.parametrize(
    ("image", "columns", "fault"),
    [
        (lambda photo: photo, 9, r"7 x 5 inner corners are in view|5 x 7 inner corners are in view"),
        (lambda photo: photo[:, :270], 7, "the frame cuts the board"),
        (lambda photo: cv2.dilate(photo, np.ones((13, 13))), 7, "far too bright: .* about 9 px"),
        (lambda photo: np.concatenate([photo, photo], axis=1), 7, "two boards"),
    ],
    ids=["another", "cut", "too wide", "two"],
)
def test_what_is_wrong_with_a_picture_is_named(image, columns, fault):
    with pytest.raises(TargetNotFound, match=fault):
        detect_board(image(picture(CHECKERBOARD)), Board("checkerboard", columns, 5, 20.0))


@pytest.mark.parametrize("kind", ["checkerboard", "circles"])
def test_an_image_without_a_board_is_refused_with_a_remedy(kind):
    board = Board(kind, 7, 5, 20.0)
    for image in (np.zeros((200, 300)), np.random.default_rng(1).random((200, 300))):
        with pytest.raises(TargetNotFound, match="was found") as error:
            detect_board(image, board, name="third")
        assert "view third" in str(error.value)
        assert "in focus" in error.value.remedy


def test_an_image_with_colours_is_refused():
    with pytest.raises(InputMismatch, match="one grey plane"):
        detect_board(np.zeros((20, 30, 3)), CHECKERBOARD)


@pytest.mark.parametrize(
    "text",
    ["", "checkerboard", "checkerboard:7x5", "checkerboard:7x5:20", "board:7x5:20mm", "circles:2x5:20mm",
     "circles:7x5:0mm", "circles:7x900:20mm", "checkerboard:7x5:1e9mm"],
)  # fmt: skip
def test_what_describes_no_board_is_refused_with_an_example(text):
    with pytest.raises(InputMismatch) as error:
        Board.parse(text)
    assert error.value.remedy


@given(
    st.sampled_from(["checkerboard", "circles", "asymmetric-circles"]),
    st.integers(3, 200),
    st.integers(3, 200),
    st.integers(1, 100_000),
)
def test_a_description_reads_back_as_itself(kind, columns, rows, tenths):
    board = Board(kind, columns, rows, tenths / 10)
    again = Board.parse(str(board))
    assert (again.kind, again.columns, again.rows) == (kind, columns, rows)
    assert again.pitch_mm == pytest.approx(board.pitch_mm, rel=1e-5)

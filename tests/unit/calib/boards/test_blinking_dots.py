"""Blinking dots are named by their frequencies and located; what is wrong with a recording is said in words."""

from functools import cache

import cv2
import numpy as np
import pytest

from calib.boards.blinking_dots import detect_blinking_dots
from calib.boards.board import Board
from calib.errors import FlickerNotFound, InputMismatch, TargetNotFound, TooFewEvents
from calib.model.homography import apply_homography

SIZE = (420, 300)
BOARD = Board("blinking-dots", 5, 4, 30.0)
#: From mm on the board to px: scale, turn and a perspective that makes the right side 12 % smaller.
PLACED = np.array([[2.1, 0.3, 60.0], [-0.15, 2.1, 66.0], [9e-4, 3e-4, 1.0]])
RADIUS_MM = 9.0


@cache
def recording(board=BOARD, placed=None, *, clock=1.0, noise=10_000, span_s=0.12, dots_off=(), second=False):
    """Events of each pixel: about four at an edge of a wholly lit one, fewer where a dot covers less of it."""
    h = PLACED if placed is None else np.array(placed)
    rng = np.random.default_rng(5)
    parts = []
    for shift in (0.0, 200.0) if second else (0.0,):
        for number, (middle, hz) in enumerate(zip(board.points_mm, board.frequencies_hz, strict=True)):
            if number in dots_off:
                continue
            rows, columns, count = fired(h, middle, shift)
            starts = rng.random() / hz + np.arange(0.0, span_s, 1.0 / hz) * 1.0
            for begin, polarity in ((0.0, 1), (0.5 / hz, 0)):
                t = clock * (starts[:, None] + begin) + 1.5e-4 * rng.random((len(starts), len(rows)))
                which = np.broadcast_to(np.arange(len(rows)), t.shape)
                for extra in range(4):
                    fires = rng.random(t.shape) < count[None] - extra
                    at = which[fires]
                    parts.append((t[fires] + 1e-4 * extra, columns[at], rows[at], np.full(len(at), polarity)))
    x, y = rng.integers(0, SIZE[0], noise), rng.integers(0, SIZE[1], noise)
    parts.append((span_s * rng.random(noise), x, y, rng.integers(0, 2, noise)))
    t, x, y, p = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    order = np.argsort(t, kind="stable")
    return ((1e6 * t[order]).astype(np.int64), x[order].astype(np.uint16), y[order].astype(np.uint16),
            p[order].astype(np.uint8))  # fmt: skip


def fired(h, middle, shift):
    """Rows and columns of the pixels that see a dot, and how many events each sends at an edge."""
    near = apply_homography(h, middle[None])[0] + [shift, 0.0]
    v, u = np.mgrid[-35:36, -35:36] + np.round(near[::-1]).astype(int)[:, None, None]
    inside = (u >= 0) & (u < SIZE[0]) & (v >= 0) & (v < SIZE[1])
    v, u = v[inside], u[inside]
    covered = np.zeros(len(u))
    steps = (np.arange(5) + 0.5) / 5 - 0.5
    for du in steps:
        for dv in steps:
            at = apply_homography(np.linalg.inv(h), np.column_stack([u + du - shift, v + dv]))
            covered += np.hypot(*(at - middle).T) < RADIUS_MM
    covered /= 25
    lit = covered > 0
    return v[lit], u[lit], 4.0 * np.log1p(20 * covered[lit]) / np.log(21)


def error_px(view, board=BOARD):
    return view.points_px - apply_homography(PLACED, board.points_mm)[view.ids]


def test_each_dot_is_named_by_its_frequency_and_lies_within_a_twentieth_of_a_pixel():
    view = detect_blinking_dots(*recording(), SIZE, BOARD)
    assert view.ids.tolist() == list(range(20))
    assert np.abs(error_px(view)).max() < 0.05
    assert np.sqrt((error_px(view) ** 2).mean()) < 0.025
    stated = np.sqrt(np.trace(view.covariances_px2, axis1=1, axis2=2).mean() / 2)
    assert 0.3 < np.sqrt((error_px(view) ** 2).mean()) / stated < 3.0


def test_the_centres_are_those_that_opencv_finds_but_for_the_bias_of_perspective():
    kept = []
    view = detect_blinking_dots(*recording(), SIZE, BOARD, keep_image=kept.append)
    grey = np.uint8(np.clip(255 * kept[0] / kept[0].max(), 0, 255))
    ok, found = cv2.findCirclesGrid(255 - grey, (5, 4), flags=cv2.CALIB_CB_SYMMETRIC_GRID)
    assert ok
    found = found.reshape(-1, 2)
    found = found if np.abs(found[0] - view.points_px[0]).max() < 5 else found[::-1]
    assert np.abs(found - view.points_px).max() < 0.3


@pytest.mark.parametrize("clock", [0.98, 1.006, 1.02])
def test_a_clock_that_is_off_by_two_per_cent_does_no_harm(clock):
    view = detect_blinking_dots(*recording(clock=clock), SIZE, BOARD)
    assert view.ids.tolist() == list(range(20))
    assert np.abs(error_px(view)).max() < 0.06


def test_a_part_of_the_board_is_enough_if_each_dot_has_its_own_frequency():
    moved = np.array([[1, 0, 105.0], [0, 1, 0], [0, 0, 1]]) @ PLACED
    view = detect_blinking_dots(*recording(placed=tuple(map(tuple, moved))), SIZE, BOARD)
    assert 10 <= len(view) < 20
    true = apply_homography(moved, BOARD.points_mm)[view.ids]
    assert np.abs(view.points_px - true).max() < 0.06


def test_two_frequencies_are_enough_if_the_whole_board_is_seen():
    frequencies = [80.0] * 20
    for corner in (0, 1, 7):
        frequencies[corner] = 120.0
    board = Board("blinking-dots", 5, 4, 30.0, tuple(frequencies))
    view = detect_blinking_dots(*recording(board), SIZE, board)
    assert view.ids.tolist() == list(range(20))
    assert np.abs(error_px(view)).max() < 0.05
    with pytest.raises(TargetNotFound, match="No grid of 5 x 4 blinking dots was found"):
        detect_blinking_dots(*recording(board, dots_off=(9, 13, 2)), SIZE, board)


def test_a_dot_that_is_off_is_left_out():
    view = detect_blinking_dots(*recording(dots_off=(7,)), SIZE, BOARD)
    assert view.ids.tolist() == [i for i in range(20) if i != 7]


@pytest.mark.parametrize(
    ("change", "second", "said"),
    [
        ([[1, 0, 210.0], [0, 1, 0], [0, 0, 1]], False, r"The frame cuts the board: .* outside the image"),
        (np.diag([0.6, 0.6, 1.0]), True, "two boards"),
        ([[-1, 0, 419.0], [0, 1, 0], [0, 0, 1]], False, "mirror order"),
    ],
    ids=["cut", "two boards", "mirror"],
)
def test_what_is_wrong_with_the_place_of_a_board_is_named(change, second, said):
    seen = recording(placed=tuple(map(tuple, np.array(change) @ PLACED)), second=second)
    with pytest.raises(TargetNotFound, match=said):
        detect_blinking_dots(*seen, SIZE, BOARD)


def test_other_frequencies_and_a_wrong_count_of_dots_are_named():
    with pytest.raises(FlickerNotFound, match=r"does so at .* Hz; the grid .* has 300 to 700 Hz"):
        detect_blinking_dots(
            *recording(), SIZE, Board("blinking-dots", 5, 4, 30.0, tuple(np.linspace(300, 700, 20)))
        )
    with pytest.raises((TargetNotFound, FlickerNotFound)) as error:
        detect_blinking_dots(*recording(), SIZE, Board("blinking-dots", 9, 6, 30.0))
    assert error.value.remedy


def test_no_flicker_and_a_short_recording_are_named():
    rng = np.random.default_rng(2)
    t = np.sort(rng.integers(0, 250_000, 40_000))
    x, y, p = (rng.integers(0, n, 40_000).astype(np.uint16) for n in (*SIZE, 2))
    with pytest.raises(FlickerNotFound, match="Nothing in view blinks"):
        detect_blinking_dots(t, x, y, p.astype(np.uint8), SIZE, BOARD)
    t, x, y, p = (a[:20_000] for a in recording())
    with pytest.raises(TooFewEvents, match=r"too short for a dot of 50 Hz") as error:
        detect_blinking_dots(t, x, y, p, SIZE, BOARD)
    assert "Record at least 100 ms" in error.value.remedy
    with pytest.raises(TooFewEvents, match="no events"):
        detect_blinking_dots(t[:0], x[:0], y[:0], p[:0], SIZE, BOARD)


@pytest.mark.parametrize(
    ("frequencies", "why"),
    [((50.0,) * 3, "3 frequencies are given for 20"), ((50.0,) * 20, "differ by less"),
     ((0.1, *range(50, 69)), "from 0.1"), ((50.0, 50.05, *range(51, 69)), "differ by less")],
)  # fmt: skip
def test_frequencies_that_name_no_dots_are_refused(frequencies, why):
    with pytest.raises(InputMismatch, match=why):
        Board("blinking-dots", 5, 4, 30.0, tuple(frequencies))


def test_a_board_of_dots_reads_back_as_itself():
    board = Board.parse("blinking-dots:9x6:25mm@60-166Hz")
    assert Board.parse(str(board)) == board
    assert board.frequencies_hz[0] == 60.0
    assert board.frequencies_hz[-1] == 166.0
    assert Board.parse("blinking-dots:9x6:25mm").frequencies_hz[-1] == 150.0
    with pytest.raises(InputMismatch, match="has no frequencies"):
        Board.parse("circles:9x6:25mm@60-166Hz")

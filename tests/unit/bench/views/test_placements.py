"""What the operator is told about the last placement of a board, and about the next one."""

import numpy as np
import pytest

from bench.records.history import Attempt, History
from bench.views.measure_board import with_advice
from calib.boards.board import Board
from sequences.script import PromptStep

BOARD = Board("checkerboard", 8, 5, 20.0)
ASKED = "Place the board."
#: From node to px: a board in the middle, 60 px a square.
GRID = np.array([[60.0, 0.0, 430.0], [0.0, 60.0, 240.0], [0.0, 0.0, 1.0]])
HALF_TURN = np.diag([-1.0, -1.0, 1.0])


def attempt(number, grid, *, accepted=True, reasons=()):
    measured = {} if grid is None else {"grid": np.asarray(grid).tolist()}
    return Attempt(
        number, f"placement {number}", 1,
        stored={"facts": {"width": 1280, "height": 720}},
        checked={"accepted": accepted, "measured": measured, "reasons": list(reasons), "gates": [], "stars": 40},
    )  # fmt: skip


def told(*attempts):
    history = History(attempts=list(attempts))
    step = PromptStep(1, "line 1", ("steps", 0), ASKED, "continue", 1.0, placement=2)
    return with_advice(step, history, BOARD).text


def moved(x, y):
    return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]]) @ GRID


def test_before_the_first_placement_nothing_is_added():
    assert told() == ASKED


def test_a_placement_is_described_and_the_next_one_named():
    text = told(attempt(1, GRID), attempt(2, moved(-300, -150)))
    assert "Placement 2: board found, 40 of 40 points, moved 335 px." in text
    assert "upper left corner. Next: move the board to the upper right corner" in text
    assert text.endswith(ASKED)


def test_a_board_that_was_not_moved_is_named():
    assert "NOT MOVED since placement 1 (3.0 px)" in told(attempt(1, GRID), attempt(2, moved(3, 0)))


def test_a_board_upside_down_and_a_board_that_the_frame_cuts_are_named():
    turned = moved(850, 480) @ np.linalg.inv(GRID) @ HALF_TURN @ GRID
    assert "upside down" in told(attempt(1, turned))
    assert "upside down" not in told(attempt(1, GRID))
    assert "the frame cuts the board" in told(attempt(1, moved(600, 0)))
    assert "cuts" not in told(attempt(1, GRID))


@pytest.mark.parametrize("reason", ["No board was found.", "No board was found"])
def test_a_placement_that_was_not_accepted_gives_its_reason(reason):
    text = told(attempt(1, GRID), attempt(2, None, accepted=False, reasons=[reason]))
    assert text.startswith("Placement 2 was not accepted: No board was found. Next: ")

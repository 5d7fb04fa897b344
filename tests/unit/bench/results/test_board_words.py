"""Errors of the engine about a board speak of points."""

import pytest

from bench.commands.calibrate import run_text
from bench.report.text import BOARD, STARS
from bench.results.solution import errors_in
from calib.errors import DegenerateViews, InputMismatch

ROW = {
    "folder": "runs/cam7",
    "state": "done",
    "values": {"fx": 3345.0},
    "sigma": {"fx": 1.0},
    "coverage_factor": 2.0,
    "views": 12,
    "stars": 924,
    "left_out": [],
    "converged": True,
    "before": None,
}


def test_an_error_keeps_its_class_and_its_place():
    with pytest.raises(DegenerateViews) as caught, errors_in(BOARD):
        raise DegenerateViews("Two stars.", where="star 3.raw", remedy="Turn it, with the stars elsewhere.")
    assert (caught.value.what, caught.value.where) == ("Two points.", "star 3.raw")
    assert str(caught.value) == "star 3.raw: Two points. Turn it, with the points elsewhere."


def test_an_error_about_stars_stays_the_same_object():
    error = InputMismatch("Two stars.")
    with pytest.raises(InputMismatch) as caught, errors_in(STARS):
        raise error
    assert caught.value is error


@pytest.mark.parametrize(
    ("board", "words"), [("checkerboard:11x7:20mm", "924 points"), (None, "924 stars"), (..., "924 stars")]
)
def test_a_recalibrated_run_counts_what_its_target_has(board, words):
    row = (
        ROW if board is ... else {**ROW, "board": board}
    )  # rows of earlier versions say nothing about boards
    assert words in run_text(row)

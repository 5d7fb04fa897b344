"""A board in words: a pitch in another unit is not taken for mm, and boards that are not found are said."""

import pytest

from calib.boards.board import Board
from calib.errors import InputMismatch


@pytest.mark.parametrize("pitch", ["2.5cm", "0.025m", "25", "25000um"])
def test_a_pitch_in_another_unit_is_refused_with_its_value_in_mm(pitch):
    with pytest.raises(InputMismatch, match="pitch") as error:
        Board.parse(f"checkerboard:9x6:{pitch}")
    assert "25mm" in error.value.remedy


def test_large_letters_are_no_other_board():
    assert Board.parse("Checkerboard:9X6:25MM") == Board("checkerboard", 9, 6, 25.0)


@pytest.mark.parametrize("kind", ["charuco", "aprilgrid"])
def test_a_board_with_markers_is_refused_by_name(kind):
    with pytest.raises(InputMismatch, match=kind) as error:
        Board.parse(f"{kind}:9x6:25mm")
    assert "checkerboard" in error.value.remedy
    assert "markers" in error.value.remedy

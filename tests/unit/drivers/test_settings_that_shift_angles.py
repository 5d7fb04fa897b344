"""Settings of a controller under which its numbers mean something else: refused, or put right, before any move."""

from __future__ import annotations

import pytest

from drivers.errors import OutsideLimits
from drivers.stage import AxisLimits
from drivers.stage.grbl import GrblAxis, GrblStage
from tests.unit.drivers.grbl_peer import GrblPeer

LIMITS = AxisLimits(-15.0, 15.0, 10.0, 50.0)


@pytest.fixture
def board(clock) -> GrblPeer:
    return GrblPeer(clock)


def grbl(board, clock, letters: str = "XY") -> GrblStage:
    axes = [
        GrblAxis(name=name, letter=letter, steps_per_deg=100.0, zero_deg=18.0, limits=LIMITS)
        for name, letter in zip(("pan", "tilt"), letters, strict=False)
    ]
    return GrblStage(board, axes, clock=clock)


@pytest.mark.parametrize(("mask", "name"), [(1, "pan"), (2, "tilt"), (3, "pan")])
def test_an_axis_that_homes_downwards_is_refused_since_its_zero_lies_where_its_travel_ends(
    board, clock, mask, name
) -> None:
    board.settings[23] = float(mask)
    before = dict(board.settings)
    with pytest.raises(OutsideLimits, match=rf"{name}: .*\$23={mask}"):
        grbl(board, clock)
    assert board.settings == before
    assert board.motions() == []


def test_how_an_axis_homes_that_is_not_ours_is_none_of_ours(board, clock) -> None:
    board.settings[23] = 2.0
    assert grbl(board, clock, "X").axes == ("pan",)


def test_a_board_that_reports_inches_is_set_to_degrees(board, clock) -> None:
    board.settings[13] = 1.0
    grbl(board, clock)
    assert board.settings[13] == 0.0

"""Settings of a controller under which its numbers mean something else: refused, or put right, before any move."""

from __future__ import annotations

import struct

import pytest

from drivers.errors import DeviceRefused, OutsideLimits
from drivers.stage import AxisLimits
from drivers.stage.grbl import GrblAxis, GrblStage
from drivers.stage.ximc import XimcAxis, XimcStage
from drivers.stage.zaber import ZaberAxis, ZaberStage
from tests.unit.drivers.grbl_peer import GrblPeer
from tests.unit.drivers.ximc_peer import XimcPeer
from tests.unit.drivers.zaber_peer import ZaberPeer

LIMITS = AxisLimits(-15.0, 15.0, 10.0, 50.0)


# ---------------------------------------------------------------- GRBL
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


# ---------------------------------------------------------------- XIMC
def ximc(peer, clock) -> XimcStage:
    axis = XimcAxis(name="pan", port="", serial="", steps_per_deg=80.0, limits=LIMITS)
    return XimcStage([peer], [axis], clock=clock)


@pytest.mark.parametrize("feedback", [1, 6])
def test_a_controller_that_counts_in_encoder_steps_is_refused_before_its_speed_is_set(
    clock, feedback
) -> None:
    peer = XimcPeer(clock)
    peer.feedback = feedback
    with pytest.raises(DeviceRefused, match="counts by its encoder"):
        ximc(peer, clock)
    assert [data for data in peer.sent if data[:1] == b"s"] == []


def test_borders_at_counts_are_narrowed_never_widened(clock) -> None:
    peer = XimcPeer(clock)
    peer.eds = before = struct.pack("<BBihih6s", 0x07, 0, -1200, 0, 1199, 0, bytes(6))
    with pytest.raises(OutsideLimits, match="but the controller allows only"):
        ximc(peer, clock)
    assert peer.eds == before
    peer.eds = struct.pack("<BBihih6s", 0x07, 0, -1200, 0, 1200, 0, bytes(6))
    ximc(peer, clock)


# ---------------------------------------------------------------- Zaber
def test_an_acceleration_too_small_to_be_told_is_refused_not_made_infinite(clock) -> None:
    """``accel`` 0 would switch the ramp off."""
    slow = AxisLimits(-15.0, 15.0, 10.0, 6.0)
    axis = ZaberAxis(name="pan", device=1, serial="", microsteps_per_deg=1000.0, limits=slow)
    peer = ZaberPeer(clock)
    with pytest.raises(OutsideLimits, match="6 deg/s"):
        ZaberStage(peer, [axis], clock=clock)
    assert peer.pan.settings["accel"] == "1"

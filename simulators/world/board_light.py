"""The light of a board: driven by the bench's light, by a screen's own refresh, or steady.

This module returns the light as the camera sees it; blinking dots and the lines of a screen, which are lights of their
own, are those of ``pixels.many_lights``.
"""

from __future__ import annotations

from dataclasses import replace

from simulators.world.board_truth import BoardTruth
from simulators.world.light_state import FULL_DRIVE_V, LightState


def light_of_board(state: LightState, board: BoardTruth, *, flickers: bool, on_since_s: float) -> LightState:
    """Return the light of a board as the camera sees it.

    state: State of the bench's light.
    flickers: Whether the board flickers.
    Returns: A screen with a refresh rate shines by itself, and no sync edges reach the camera. A print in
      steady light does not flicker, though the sync edges of the bench's light go on.
    """
    if board.own_clock:
        state = LightState(
            frequency_hz=board.flicker_hz,
            duty_percent=100.0 * board.frames_on / (board.frames_on + board.frames_off),
            high_v=FULL_DRIVE_V,
            output=True,
            origin_s=on_since_s,
        )
    return state if flickers else replace(state, low_v=state.high_v)

"""What a person can change by hand while the bench runs: the camera's place in the mount, its lens, and the board.

This module holds the state, and puts it into the truth; ``world`` keeps its past.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from simulators.world.board_truth import BoardState
from simulators.world.lens_truth import LensTruth
from simulators.world.truth import Truth


@dataclass(frozen=True)
class CameraSetup:
    """How the camera stands in its mount, and how its lens is set."""

    # Displacement across the beam from where the camera was aligned, along the target's X and Y.
    shift_mm: tuple[float, float]
    turn_deg: tuple[float, float, float]
    lens: LensTruth
    board: BoardState = field(default_factory=BoardState)


def setup_of(truth: Truth) -> CameraSetup:
    """Return the camera's setup in a truth."""
    return CameraSetup(truth.mount.shift_mm, truth.mount.turn_deg, truth.lens, truth.board.state)


def with_setup(truth: Truth, setup: CameraSetup) -> Truth:
    """Return the truth with the camera set up in another way.

    Returns: The same object if the camera is set up so already.
    """
    if setup == setup_of(truth):
        return truth
    mount = replace(truth.mount, shift_mm=setup.shift_mm, turn_deg=setup.turn_deg)
    return replace(truth, mount=mount, lens=setup.lens, board=truth.board.in_state(setup.board))

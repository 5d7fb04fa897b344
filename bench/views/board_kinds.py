"""The two kinds of cameras in front of a board at finite distance: how a recording is measured and judged.

Everything else is as in front of the collimator (`bench.views.camera_kinds`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from bench.views.camera_kinds import EventKind, FrameKind, StoredFacts
from bench.views.gates import Gate, at_least
from bench.views.recording_window import periods_in_window
from calib.boards.board import Board
from calib.target import StarTarget
from drivers.camera.frames import FrameSettings
from sequences.script import RecordStep

if TYPE_CHECKING:
    from bench.views.measure import ExpectedGrid, Measurement

_LEAST_SHARE = 0.5
"""A recording needs this share of the board's points, at most; the detectors of printed boards need more."""


class EventBoardKind(EventKind):
    """An event camera in front of a board.

    roi: Region of interest: the only part of the sensor that sends events; None for the whole sensor.
    """

    def __init__(
        self,
        biases: Mapping[str, int],
        board: Board,
        roi: tuple[int, int, int, int] | None = None,
    ) -> None:
        super().__init__(biases, roi)
        self._board = board

    def measure(
        self,
        path: Path,
        step: RecordStep,
        frequency_hz: float,
        target: StarTarget,  # noqa: ARG002
        expected_grid: ExpectedGrid | None,  # noqa: ARG002
        *,
        motion: bool = True,  # noqa: ARG002
    ) -> Measurement:
        """See `CameraKind.measure`. Finds the board."""
        from bench.views.measure_board import measure_board

        return measure_board(
            path,
            name=step.pose.name,
            board=self._board,
            image=step.image,
            periods=periods_in_window(step.window_ms, frequency_hz),
            expected_hz=frequency_hz,
        )

    def judge(
        self, facts: StoredFacts, step: RecordStep, frequency_hz: float, found: Measurement
    ) -> tuple[list[Gate], list[str]]:
        """See `CameraKind.judge`. Judges points, event rate, triggers, flicker and motion."""
        gates, reasons = super().judge(facts, step, frequency_hz, found)
        return _about_points(gates, self._board, step, found), reasons


class FrameBoardKind(FrameKind):
    """A frame camera in front of a board."""

    def __init__(self, frames: int, settings: FrameSettings, board: Board) -> None:
        super().__init__(frames, settings)
        self._board = board

    def measure(
        self,
        path: Path,
        step: RecordStep,
        frequency_hz: float,  # noqa: ARG002
        target: StarTarget,  # noqa: ARG002
        expected_grid: ExpectedGrid | None,  # noqa: ARG002
        *,
        motion: bool = True,  # noqa: ARG002
    ) -> Measurement:
        """See `CameraKind.measure`. Finds the board in the mean of the frames."""
        from bench.views.measure_board import measure_board_frames

        return measure_board_frames(path, name=step.pose.name, board=self._board)

    def judge(
        self, facts: StoredFacts, step: RecordStep, frequency_hz: float, found: Measurement
    ) -> tuple[list[Gate], list[str]]:
        """See `CameraKind.judge`. Judges points, saturation and motion."""
        gates, reasons = super().judge(facts, step, frequency_hz, found)
        return _about_points(gates, self._board, step, found), reasons


def _about_points(gates: list[Gate], board: Board, step: RecordStep, found: Measurement) -> list[Gate]:
    """Return the gates with the points of a board in place of stars; a small board needs no 40 of them."""
    least = min(step.gates.min_stars, _LEAST_SHARE * len(board.nodes))
    judged = [] if found.view is None else [at_least("points", found.stars, least, "")]
    others = (gate for gate in gates if gate.name != "stars")
    return judged + [
        replace(gate, name="board moved") if gate.name == "stars moved" else gate for gate in others
    ]

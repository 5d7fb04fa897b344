"""From one recording of a board at finite distance to one view: the counterpart of `bench.views.measure`.

Every number is calculated from the file alone, so that it can be calculated again from the evidence.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.records.events import MeasuredFacts
from bench.views.event_window import EventData, read_events, whole_image
from bench.views.measure import Measurement, plain_facts
from bench.views.stored_image import StoredImage
from calib.boards.blinking_dots import detect_blinking_dots
from calib.boards.board import Board
from calib.boards.detect import detect_board, relocate_board
from calib.errors import CalibrationError, FlickerNotFound, TargetNotFound, TooFewEvents, TooFewStars
from calib.events.motion import motion_between
from calib.model.homography import fit_homography
from calib.view import View
from drivers.camera.frames import read_frames
from drivers.errors import RecordingFileError

_LEAST_LIT = 1e-3
"""Share of the pixels that fire at an edge of the light; below it, nothing in view flickers."""


def measure_board(
    path: Path,
    *,
    name: str,
    board: Board,
    image: str,
    periods: int | None,
    expected_hz: float | None,
) -> Measurement:
    """Read a recording of events and find a board in it.

    path: RAW file.
    image: Kind of event image, or ``auto``; blinking dots have their own.
    periods: Number of whole flicker periods to use; None for all that the recording holds.
    expected_hz: Nominal frequency of the flicker, Hz; None if unknown.
    Returns: Also if the file cannot be read or shows no board; then it holds the fault.
    """
    facts: MeasuredFacts = {}
    stored: list[StoredImage] = []
    try:
        data = read_events(path)
        if board.kind == "blinking-dots":
            view, halves = _of_dots(data, board, name, stored)
        else:
            view, halves = _of_image(data, board, name, stored, facts, (image, periods, expected_hz))
        _state(view, halves, board, facts)
    except (CalibrationError, RecordingFileError) as error:
        return Measurement(None, stored[0] if stored else None, plain_facts(facts), str(error))
    return Measurement(view, stored[0], plain_facts(facts))


def measure_board_frames(path: Path, *, name: str, board: Board) -> Measurement:
    """Read the frames of a placement and find a board in their mean.

    board: The board; no blinking dots, which need events.
    Returns: Also if the file cannot be read or shows no board; then it holds the fault.
    """
    facts: MeasuredFacts = {}
    stored: StoredImage | None = None
    try:
        frames = read_frames(path)
        mean = _mean(frames)
        stored = StoredImage.from_image(mean)
        kind = f"mean of {len(frames)} pictures" if len(frames) > 1 else "picture"
        facts["image"] = {"kind": kind, "reason": "", "pictures": len(frames)}
        view = detect_board(mean, board, name=name)
        half = len(frames) // 2
        parts = [_mean(part) for part in (frames[:half], frames[-half:])] if half else []
        _state(view, [relocate_board(part, view, board) for part in parts], board, facts)
    except (CalibrationError, RecordingFileError) as error:
        return Measurement(None, stored, facts, str(error))
    return Measurement(view, stored, facts)


def _of_image(
    data: EventData,
    board: Board,
    name: str,
    stored: list[StoredImage],
    facts: MeasuredFacts,
    wanted: tuple[str, int | None, float | None],
) -> tuple[View, list[View]]:
    """Find a board in the event image of whole periods, and in the images of the halves of the window."""
    # Without sync edges, the board is a screen of its own, which may be drawn line by line.
    whole = whole_image(data, *wanted, facts, one_phase=len(data.triggers.t) > 0)
    stored.append(StoredImage.from_image(whole.image))
    try:
        view = detect_board(whole.image, board, name=name)
    except TargetNotFound as error:
        lit = facts["image"]["lit_pixels"]
        if lit < _LEAST_LIT * whole.image.size:
            raise FlickerNotFound(
                f"Nothing in view flickers: {lit} pixels fire with the light.",
                where=f"view {name}",
                remedy="Switch on the flicker of the board or its light; take off the lens cap.",
            ) from error
        raise
    try:
        return view, [relocate_board(half, view, board) for half in whole.halves()]
    except (TooFewEvents, TargetNotFound):
        return view, []


def _of_dots(data: EventData, board: Board, name: str, stored: list[StoredImage]) -> tuple[View, list[View]]:
    """Find blinking dots, in the whole recording and in its halves."""
    events = data.events
    t, x, y, p = events.t, events.x, events.y, events.p
    found = detect_blinking_dots(t, x, y, p, data.size, board, name=name, keep_image=stored_image(stored))
    middle = int(np.searchsorted(t, 0.5 * (float(t[0]) + float(t[-1]))))
    halves = []
    try:
        for part in (slice(None, middle), slice(middle, None)):
            half = detect_blinking_dots(t[part], x[part], y[part], p[part], data.size, board, name="half")
            halves.append(half)
    except CalibrationError:
        return found, []
    return found, halves


def stored_image(stored: list[StoredImage]) -> Any:
    """Return a function that keeps an image.

    stored: Where to keep it.
    Returns: Takes the image, (H, W) float32.
    """

    def keep(image: NDArray[np.float32]) -> None:
        stored.append(StoredImage.from_image(image))

    return keep


def _state(view: View, halves: list[View], board: Board, facts: MeasuredFacts) -> None:
    """State what labelled the points, where their grid lies, and the motion during the recording."""
    nodes = board.nodes[view.ids].astype(np.float64)
    facts["named_by"] = "frequency" if board.kind == "blinking-dots" else "board"
    facts["grid"] = fit_homography(nodes, view.points_px).tolist()
    facts["motion_px"] = None
    if len(halves) == 2:
        with suppress(TooFewStars):
            facts["motion_px"] = motion_between(halves[0], halves[1]).length_px


def _mean(frames: NDArray[Any]) -> NDArray[np.float32]:
    return frames.mean(axis=0, dtype=np.float64).astype(np.float32)

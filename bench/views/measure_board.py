"""From one recording of a board at finite distance to one view: the counterpart of `bench.views.measure`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bench.base.errors import UsageError
from bench.records.events import MeasuredFacts
from bench.records.history import Attempt, History
from bench.views.measure import (
    EventData,
    Measurement,
    Observed,
    mean_frames,
    measurement_of,
    read_events,
    whole_image,
)
from calib.boards.blinking_dots import detect_blinking_dots
from calib.boards.board import Board
from calib.boards.detect import detect_board, relocate_board
from calib.errors import CalibrationError, FlickerNotFound, TargetNotFound, TooFewEvents, TooFewStars
from calib.events.event_image import motion_between
from calib.events.reconstruction import ReconstructedPicture, reconstruct
from calib.model.homography import fit_homography
from calib.view import View
from drivers.camera.raw_file import RawFile
from sequences.script import PromptStep

if TYPE_CHECKING:
    from calib.boards.coverage import Seen

# A recording of a moving camera before a still board: pictures at stated times, reconstructed from its RAW
# file.
#
# The file is read in pieces, so its length does not matter. This module finds no board.

MOVING_REMEDY = (
    "Move the camera obliquely to the edges of the board, by more than two squares around the time of the picture; "
    "for slow motion give a lower frequency to --reconstruct."
)
_MOST_PICTURES = 40
_LEAST_APART_S = 0.1


class MovingRecording:
    """Pictures of one recording, by a filter with a cutoff frequency, at times after its first event, s."""

    def __init__(self, path: Path, cutoff_hz: float, at_s: Sequence[float] | None = None) -> None:
        self._path, self._cutoff_hz = path, cutoff_hz
        self._first_us, last_us = _span_us(path)
        length_s = 1e-6 * (last_us - self._first_us)
        if at_s is not None and at_s[-1] > length_s:
            raise UsageError(
                f"There is no picture at {at_s[-1]:g} s: the recording is {length_s:.3f} s long.",
                where=str(path),
                remedy="Give earlier times to --pictures-at.",
            )
        self.at_s = _spread(length_s) if at_s is None else tuple(at_s)
        self._next = 0
        self._stream = self._reconstructed()

    def picture(self, number: int) -> ReconstructedPicture:
        """Return a picture, numbered from 0; fastest in the order of their times."""
        if number < self._next:
            self._next, self._stream = 0, self._reconstructed()
        while True:
            found = next(self._stream)
            self._next += 1
            if self._next > number:
                return found

    def _reconstructed(self) -> Iterator[ReconstructedPicture]:
        raw = RawFile.open(self._path)
        times_us = [self._first_us + 1e6 * at_s for at_s in self.at_s]
        return reconstruct(raw.chunks(), (raw.width, raw.height), times_us, cutoff_hz=self._cutoff_hz)


def _span_us(path: Path) -> tuple[int, int]:
    """Return the times of the first and the last event, us."""
    first, last = None, 0
    for events in RawFile.open(path).chunks():
        first = int(events.t[0]) if first is None else first
        last = int(events.t[-1])
    if first is None:
        raise TooFewEvents("The recording holds no event.", where=str(path))
    return first, last


def _spread(length_s: float) -> tuple[float, ...]:
    """Return the middles of equal parts of a recording, at most 40 and at least 0.1 s apart."""
    count = max(1, min(_MOST_PICTURES, int(length_s / _LEAST_APART_S)))
    return tuple(length_s * (number + 0.5) / count for number in range(count))


# What the placements of a board have shown so far, for the question that asks for the next one.
#
# Everything follows from the journal: the grid of each accepted recording says where the board stood. No
# image is read.


def with_advice(step: PromptStep, history: History, board: Board) -> PromptStep:
    """Add to a question what the last placement showed, if anything, and where the board is needed next."""
    if not history.attempts:
        return step
    last, seen = history.attempts[-1], placements_seen(history, board)
    return replace(step, text=f"{_last_text(last, seen, board)} {step.text}")


def placements_seen(history: History, board: Board) -> Sequence[Seen]:
    """Return where the board stood in the accepted recordings, in their order."""
    from calib.boards.coverage import Seen
    from calib.model.homography import apply_homography

    found = []
    for attempt in history.accepted().values():
        measured = attempt.measured
        if "grid" not in measured:
            continue
        points = apply_homography(np.array(measured["grid"]), board.nodes.astype(np.float64))
        facts = attempt.stored["facts"]
        found.append(Seen(attempt.pose_name, (int(facts["width"]), int(facts["height"])), points))
    return found


def _last_text(last: Attempt, seen: Sequence[Seen], board: Board) -> str:
    """Return what the last recording showed, and what to do next."""
    from calib.boards.coverage import advice, is_cut, shift_px, turned_upside_down

    name = f"{last.pose_name[:1].upper()}{last.pose_name[1:]}"
    next_text = f"Next: {advice(seen, board)}" if seen else ""
    if not last.accepted:
        why = "; ".join(last.reasons).removesuffix(".")
        return f"{name} was not accepted: {why}. {next_text}".strip()
    count, stars = len(board.nodes), last.checked["stars"] if last.checked else 0
    text = f"{name}: board found, {stars} of {count} points"
    own, earlier = seen[-1], seen[:-1]
    if is_cut(own.points_px, own.image_size):
        text += ", the frame cuts the board"
    if turned_upside_down(own.points_px, board):
        text += ", upside down (this does no harm)"
    nearest = min(earlier, key=lambda one: shift_px(own, one, board), default=None)
    if nearest is not None:
        moved = shift_px(own, nearest, board)
        text += (
            f", moved {moved:.0f} px"
            if moved >= own.least_shift_px
            else f"; NOT MOVED since {nearest.name} ({moved:.1f} px): it adds nothing"
        )
    return f"{text}. It covers {own.where}. {next_text}"


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
    """Read a recording of events and find a board in it; a fault instead if it is bad.

    ``image`` is a kind, or ``auto``; blinking dots have their own. ``periods`` None stands for all whole ones.
    """

    def find(seen: Observed) -> View:
        data = read_events(path)
        if board.kind == "blinking-dots":
            view, halves = _of_dots(data, board, name, seen)
        else:
            view, halves = _of_image(data, board, name, seen, (image, periods, expected_hz))
        _state(view, halves, board, seen.facts)
        return view

    return measurement_of(find)


def measure_board_frames(path: Path, *, name: str, board: Board) -> Measurement:
    """Read the frames of a placement and find a board, not of blinking dots, in their mean; else the fault."""

    def find(seen: Observed) -> View:
        mean, halves = mean_frames(path, seen)
        view = detect_board(mean, board, name=name)
        _state(view, [relocate_board(half, view, board) for half in halves], board, seen.facts)
        return view

    return measurement_of(find)


def _of_image(
    data: EventData,
    board: Board,
    name: str,
    seen: Observed,
    wanted: tuple[str, int | None, float | None],
) -> tuple[View, list[View]]:
    """Find a board in the event image of whole periods, and in the images of the halves of the window."""
    # Without sync edges, the board is a screen of its own, which may be drawn line by line.
    whole = whole_image(data, *wanted, seen.facts, one_phase=len(data.triggers.t) > 0)
    seen.keep(whole.image)
    try:
        view = detect_board(whole.image, board, name=name)
    except TargetNotFound as error:
        lit = seen.facts["image"]["lit_pixels"]
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


def _of_dots(data: EventData, board: Board, name: str, seen: Observed) -> tuple[View, list[View]]:
    """Find blinking dots, in the whole recording and in its halves."""
    t, x, y, p = data.events
    found = detect_blinking_dots(t, x, y, p, data.size, board, name=name, keep_image=seen.keep)
    middle = int(np.searchsorted(t, 0.5 * (float(t[0]) + float(t[-1]))))
    halves = []
    try:
        for part in (slice(None, middle), slice(middle, None)):
            half = detect_blinking_dots(t[part], x[part], y[part], p[part], data.size, board, name="half")
            halves.append(half)
    except CalibrationError:
        return found, []
    return found, halves


def _state(view: View, halves: list[View], board: Board, facts: MeasuredFacts) -> None:
    """State what labelled the points, where their grid lies, and the motion during the recording."""
    nodes = board.nodes[view.ids].astype(np.float64)
    facts["named_by"] = "frequency" if board.kind == "blinking-dots" else "board"
    facts["grid"] = fit_homography(nodes, view.points_px).tolist()
    facts["motion_px"] = None
    if len(halves) == 2:
        with suppress(TooFewStars):
            facts["motion_px"] = float(np.hypot(*motion_between(*halves)))

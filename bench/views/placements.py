"""What the placements of a board have shown so far, for the question that asks for the next one.

Everything follows from the journal: the grid of each accepted recording says where the board stood. No image is read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from bench.records.history import Attempt, History
from calib.boards.board import Board
from sequences.script import PromptStep

if TYPE_CHECKING:
    from calib.boards.coverage import Seen


def with_advice(step: PromptStep, history: History, board: Board) -> PromptStep:
    """Add to a question what the last placement showed, and where the board is needed next.

    Returns: The question; its text is unchanged if nothing has been recorded.
    """
    if not history.attempts:
        return step
    last, seen = history.attempts[-1], placements_seen(history, board)
    return replace(step, text=f"{_last_text(last, seen, board)} {step.text}")


def placements_seen(history: History, board: Board) -> Sequence[Seen]:
    """Return where the board stood in the accepted recordings.

    Returns: In the order of the recordings.
    """
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

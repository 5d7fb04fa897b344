"""What a report calls what the camera saw: the stars of the target, or the points of a board at finite distance."""

from __future__ import annotations

import re
from typing import NamedTuple

from bench.records.results import Results

_BOARD_WORDS = {
    "star": "point",
    "stars": "points",
    "Star": "Point",
    "Stars": "Points",
    "reticle": "board",
    "target": "board",
    "target's": "board's",
}
_WORD = re.compile(r"\b(?:target's|[Ss]tars?|reticle|target)\b")


class TargetWords(NamedTuple):
    """The words for one kind of target."""

    point: str
    points: str
    target: str

    @property
    def capital(self) -> str:
        """``points`` at the begin of a sentence."""
        return self.points.capitalize()

    @property
    def is_board(self) -> bool:
        """Whether they are words for a board."""
        return self == BOARD

    def fitting(self, text: str) -> str:
        """Return a sentence of this program, which speaks of stars, in these words.

        text: The sentence; never one that a person wrote.

        Examples
        --------
        >>> BOARD.fitting("as a bow of the reticle: the star noise, the stars' edges")
        "as a bow of the board: the point noise, the points' edges"
        """
        return _WORD.sub(lambda found: _BOARD_WORDS[found[0]], text) if self.is_board else text


STARS = TargetWords("star", "stars", "target")
BOARD = TargetWords("point", "points", "board")


def words_for(board: object) -> TargetWords:
    """Return the words for a target.

    board: The board at finite distance, or its description; None or empty for the star target.
    """
    return BOARD if board else STARS


def words_of(results: Results) -> TargetWords:
    """Return the words for what a run recorded.

    Returns: Those of a board if ``run`` names one.
    """
    return words_for((results.get("run") or {}).get("board"))

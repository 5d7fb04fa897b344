"""The words for a kind of target: stars, or the points of a board."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from bench.record.results import Results


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


STARS = TargetWords("star", "stars", "target")
BOARD = TargetWords("point", "points", "board")


def words_for(board: object) -> TargetWords:
    """Return the words for a board at finite distance or its description; without one, for the star target."""
    return BOARD if board else STARS


def words_of(results: Results) -> TargetWords:
    """Return the words for what a run recorded: those of a board if ``run`` names one."""
    return words_for((results.get("run") or {}).get("board"))

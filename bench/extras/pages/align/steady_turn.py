"""The turn that is shown stands while nothing moves: noise moves each turn, and hides a blurred tag now and then."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bench.extras.pages.align.star_watch import Sighting
from bench.extras.pages.align.where_to_turn import BEAM_STEP_PX, CENTRED_PX, TurnFigures

_RANKS: Final = {"tag": 3, "square": 2, "beam": 1, "": 0}
"""How well each thing tells where to turn."""
_ACCURACY_DEG: Final = {"tag": 0.2, "square": 0.3, "beam": 1.4, "": 0.0}
"""Largest error of a turn by what it is of, degrees (docs/measured/align.md)."""
_ACCURACY_PX: Final = {"tag": CENTRED_PX, "square": CENTRED_PX, "beam": BEAM_STEP_PX, "": 0.0}
_ROLL_ACCURACY_DEG: Final = 1.5
"""Spread of the roll by a blurred tag, degrees; that of sharp stars is far below a degree."""


class SteadyTurn:
    """Keeps the turn that is shown while the view stays, and nothing tells it better."""

    def __init__(self) -> None:
        self._shown = TurnFigures()
        self._seen: Sighting | None = None

    def steady(
        self, turn: TurnFigures, values: NDArray[np.float32], reading_deg: Mapping[str, float]
    ) -> TurnFigures:
        """Return the turn to show after a new one, seen in a picture, (H, W) float32, at angles, degrees."""
        if self._seen is None or self._seen.differs(values, reading_deg) or not _holds(self._shown, turn):
            self._shown, self._seen = turn, Sighting.of(values, reading_deg)
        return self._shown


def _holds(shown: TurnFigures, turn: TurnFigures) -> bool:
    """Return whether a turn in an unchanged view needs no other one."""
    if shown.unit != turn.unit or _RANKS[turn.of] > _RANKS[shown.of]:
        return False
    if turn.of != shown.of:
        return True
    limit = (_ACCURACY_DEG if turn.unit == "°" else _ACCURACY_PX)[turn.of]
    pairs = [(shown.pan, turn.pan), (shown.tilt, turn.tilt)]
    off = max((abs(a - b) for a, b in pairs if a is not None and b is not None), default=0.0)
    if shown.roll_deg is None or turn.roll_deg is None:
        return off <= limit and turn.roll_deg is None
    return off <= limit and abs(shown.roll_deg - turn.roll_deg) <= _ROLL_ACCURACY_DEG

"""A state over time, of which the past can be looked up."""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import Generic, TypeVar

from simulators.errors import SimulationMisuse

_State = TypeVar("_State")


class History(Generic[_State]):
    """A state over time: the state at a past moment can be looked up.

    first: State at all times before the first one that is appended.
    """

    def __init__(self, first: _State) -> None:
        self._since: list[float] = [-math.inf]
        self._states: list[_State] = [first]

    def append(self, since_s: float, state: _State) -> None:
        """Set the state from a moment on.

        state: State until the next one is appended.
        Raises SimulationMisuse: If the moment is earlier than that of the previous state.
        """
        if since_s < self._since[-1]:
            raise SimulationMisuse(
                f"A state at {since_s} s cannot follow one at {self._since[-1]} s.",
                remedy="Set states in order of time.",
            )
        self._since.append(since_s)
        self._states.append(state)

    def at(self, t_s: float) -> _State:
        """Return the state at a moment.

        Returns: The last one that was appended for this moment or an earlier one.
        """
        return self._states[bisect_right(self._since, t_s) - 1]

    @property
    def latest(self) -> _State:
        """State that was appended last."""
        return self._states[-1]

    def forget_before(self, t_s: float) -> None:
        """Drop states that ended before a moment."""
        first = bisect_right(self._since, t_s) - 1
        del self._since[:first]
        del self._states[:first]

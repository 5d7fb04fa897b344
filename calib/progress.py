"""Tells a person who waits how far a calibration is.

A calibration takes one search or more, each of some rounds. The number of searches that are expected can grow.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

#: Rounds of a search: the mean of 134 searches of 89 benches of six worlds, half of which had at most 8.
_ROUNDS = 10
#: A search that goes on after these rounds counts as done by this share.
_ALMOST = 0.9
#: What follows the last search (modes, mixture, causes) takes this share of the time of the first one: a third to a
#: half on benches of three to nine poses.
_REST = 0.4

#: Is called with the work that is done, and with all that is expected.
Reached = Callable[[float, float], None]


@dataclass
class _Searches:
    """The searches of one calibration after another."""

    reached: Reached
    done: int = 0
    expected: int = 1

    def tell(self, share: float) -> None:
        """Tell how far the work is, with a share of the present search."""
        self.reached(self.done + share, max(self.expected, self.done + 1) + _REST)


_watched: ContextVar[_Searches | None] = ContextVar("watched", default=None)


@contextmanager
def shown_by(reached: Reached) -> Iterator[None]:
    """Let ``reached`` be told, in this thread, how far each calibration in the block is."""
    token = _watched.set(_Searches(reached))
    try:
        yield
    finally:
        _watched.reset(token)


def begin() -> None:
    """Begin with a calibration, of which one search is known to be needed."""
    if searches := _watched.get():
        searches.done, searches.expected = -1, 1


def expect(more: int) -> None:
    """Say that so many searches are needed beside the present one."""
    if searches := _watched.get():
        searches.expected = max(searches.expected, searches.done + 1) + more


def in_round(number: int) -> None:
    """Say which round of a search begins, from 0; with that one the search before has ended."""
    if searches := _watched.get():
        searches.done += number == 0
        searches.tell(min(number / _ROUNDS, _ALMOST))

"""All events of a stream in common arrays, whose final length is only estimated while they are filled.

Memory that has not been touched costs nothing, so arrays may be somewhat too long at first. If they are too short, they
grow in place, or the events wait in arrays of their own until those before them are complete.
"""

from __future__ import annotations

from drivers.camera.event_arrays import Events, copy_events, empty_events


class GrowingEvents:
    """Arrays that are filled block by block, also by several threads at once.

    Examples
    --------
    >>> events = GrowingEvents(1)
    >>> for number in (5, 6):
    ...     room = events.room(1)
    ...     room.t[0] = number
    ...     events.add(room.part(0, 1))
    >>> events.finished().t.tolist()
    [5, 6]
    """

    def __init__(self, expected: int) -> None:
        self._arrays = empty_events(expected)
        self._given = 0
        self._done = 0

    def room(self, most: int) -> Events:
        """Return arrays for the next block.

        Returns: Part of the common arrays if there is room, else new arrays.
        """
        begin, self._given = self._given, self._given + most
        if self._given > len(self._arrays.t):
            if self._done < begin:
                return empty_events(
                    most
                )  # blocks before it are still being filled: the arrays cannot move now
            self._grow(self._given)
        return self._arrays.part(begin, self._given)

    def add(self, part: Events) -> None:
        """Add the events of the next block, in the order of the stream.

        part: Its events: the first ones of its room, or other arrays.
        """
        end = self._done + len(part.t)
        if end > len(self._arrays.t):
            self._grow(end)
        place = self._arrays.part(self._done, end)
        if len(part.t) and place.t.ctypes.data != part.t.ctypes.data:
            copy_events(part, place)
        self._done = end

    def close_gap(self) -> None:
        """Let the next block begin right behind the events so far; no block may be in work."""
        self._given = self._done

    def finished(self) -> Events:
        """Return all events; the arrays are no longer used here.

        Returns: The filled part of the arrays; these are cut only if much of them is empty. Memory of the
          same size can then be used again for the next file.
        """
        if len(self._arrays.t) > self._done + self._done // 4:
            self._resize(self._done)
        return self._arrays.part(0, self._done)

    def _grow(self, least: int) -> None:
        """Make the arrays longer than is needed now."""
        self._resize(least + least // 8)

    def _resize(self, size: int) -> None:
        """Change the length of the arrays in place; nobody holds parts of them."""
        for array in self._arrays:
            array.resize(size, refcheck=False)

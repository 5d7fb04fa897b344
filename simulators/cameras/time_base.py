"""The clock of a simulated sensor from power-up on: it goes while a stream is taken, and stands in between.

Knows numbers only; neither sensor nor socket. One thread at a time.
"""

from __future__ import annotations


class TimeBase:
    """Where the clock stands.

    Frames that were sent and that the host threw away, because they came after its stop, are as if never advance: how
    many they are is chance, and the next stream is to begin at the same time in every equal run.

    Examples
    --------
    >>> clock = TimeBase()
    >>> clock.start(0)
    >>> clock.advance(2000, sent=True), clock.advance(4000, sent=True)
    (None, None)
    >>> clock.stop(1), clock.now_us
    (True, 2000)
    """

    def __init__(self) -> None:
        self.now_us = 0
        """Sensor time, us, not wrapped."""
        self._sent_us = [0]

    def power_up(self) -> None:
        """Begin at 0."""
        self.start(0)

    def start(self, at_us: int) -> None:
        """Go on with a stream that begins at that time, us."""
        self.now_us = at_us
        self._sent_us = [at_us]

    def advance(self, until_us: int, *, sent: bool) -> None:
        """Go on to the end of a frame, us; ``sent``: the host can have it."""
        self.now_us = until_us
        if sent:
            self._sent_us.append(until_us)

    def stop(self, frames: int) -> bool:
        """Stand at the end of the last frame that the host has kept, of so many; False when fewer were sent."""
        if frames >= len(self._sent_us):
            return False
        self.now_us = self._sent_us[frames]
        return True

"""Clock of a simulated sensor since power-up: it runs during a stream and stands still between streams.

The module computes numbers only. It is not thread-safe: use it from one thread at a time.
"""

from __future__ import annotations


class TimeBase:
    """State of the sensor's clock.

    The host discards frames that arrive after its stop command. Their number depends on chance. The clock
    therefore stands at the end of the last frame that the host kept, so that the next stream begins at the same
    time in every equal run.

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
        """Set the clock to 0."""
        self.start(0)

    def start(self, at_us: int) -> None:
        """Begin a stream.

        at_us: Sensor time at which the stream begins, us.
        """
        self.now_us = at_us
        self._sent_us = [at_us]

    def advance(self, until_us: int, *, sent: bool) -> None:
        """Advance the clock to the end of a frame.

        until_us: Sensor time at the end of the frame, us.
        sent: Whether the frame was sent to the host.
        """
        self.now_us = until_us
        if sent:
            self._sent_us.append(until_us)

    def stop(self, frames: int) -> bool:
        """Set the clock to the end of the last frame that the host kept.

        Returns: False if fewer frames were sent; the clock then stays as it is.
        """
        if frames >= len(self._sent_us):
            return False
        self.now_us = self._sent_us[frames]
        return True

"""Clocks that a test turns: hurried on, or stepped while the camera computes."""

import time

from turned_clock import TurnedClock


class HurryingClock(TurnedClock):
    """Stands still until told to hurry; then every wait takes a second."""

    hurry = False

    def sleep(self, seconds):
        self.now_s += 1.0 if self.hurry else 0.0


class SteppedClock(TurnedClock):
    """Goes on where a test says so; counts the rounds that a driver waits."""

    rounds = 0

    def sleep(self, seconds):
        self.rounds += 1

    def let_pass(self, seconds, peer, patience_s=10.0):
        """Let time pass in which the peer says that it computes, as long as somebody waits for it."""
        for _ in range(round(seconds / 20)):
            peer.send(b"N", b'{"event": "computing"}')
            heard, deadline = self.rounds + 2, time.monotonic() + patience_s
            while self.rounds < heard:
                if time.monotonic() > deadline:
                    return
                time.sleep(0.001)
            self.now_s += 20.0

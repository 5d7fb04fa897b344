"""Clocks that a test turns: hurried on, or stepped while the camera computes."""

import time

from drivers.clock import SystemClock


class HurryingClock(SystemClock):
    """Stands still until told to hurry; then every wait takes a second."""

    def __init__(self):
        self.now = 0.0
        self.hurry = False

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.now += 1.0 if self.hurry else 0.0


class SteppedClock(SystemClock):
    """Goes on where a test says so; counts the rounds that a driver waits."""

    def __init__(self):
        self.now = 0.0
        self.rounds = 0

    def monotonic(self):
        return self.now

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
            self.now += 20.0

"""A clock that a test turns."""


class TurnedClock:
    """Time passes only where somebody waits, or where a test says so; ``error`` is raised by the next wait."""

    def __init__(self, now_s: float = 0.0) -> None:
        self.now_s = now_s
        self.error: BaseException | None = None

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds
        if self.error is not None:
            raise self.error

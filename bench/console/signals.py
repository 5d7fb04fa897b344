"""Signals become a request to stop; the run then ends at its next wait, safely.

The first SIGINT, SIGTERM or SIGHUP asks; while the bench makes itself safe, more of them are only counted. Only
the third SIGINT gives the operator the default back: the process ends at once, whatever it is doing.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_STOPPING = ("SIGINT", "SIGTERM", "SIGHUP")
_PATIENCE = 3


@contextmanager
def stop_on_signals(request_stop: Callable[[str], None]) -> Iterator[None]:
    """Turn stopping signals into ``request_stop(reason)`` while the block runs (main thread only)."""
    received = 0

    def ask(number: int, _frame: FrameType | None) -> None:
        nonlocal received
        received += 1
        if received >= _PATIENCE and number == signal.SIGINT:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        request_stop(f"{signal.Signals(number).name} received")

    numbers = [getattr(signal, name) for name in _STOPPING if hasattr(signal, name)]
    before = {number: signal.signal(number, ask) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

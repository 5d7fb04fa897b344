"""Signals become a request to stop: a run then ends at its next wait, safely, any other work at once.

In a run, the first SIGINT, SIGTERM or SIGHUP asks; while the bench makes itself safe, more of them are only counted.
Only the third SIGINT gives the operator the default back: the process ends at once, whatever it is doing.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_STOPPING = ("SIGINT", "SIGTERM", "SIGHUP")
_PATIENCE = 3
_AGAIN_S = 0.05


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


@contextmanager
def reliable_interrupts() -> Iterator[None]:
    """Let SIGTERM break the block off as Ctrl-C does, with all cleaning up, and let no interrupt be lost (main thread).

    Python drops what is raised while it clears objects away; where files are written piece by piece, that is often.
    """
    hook = sys.unraisablehook
    timers: list[threading.Timer] = []
    main = threading.get_ident()

    def again(lost: sys.UnraisableHookArgs) -> None:
        if issubclass(lost.exc_type, KeyboardInterrupt):  # later: within this hook it would be lost as well
            timers.append(threading.Timer(_AGAIN_S, signal.pthread_kill, (main, signal.SIGINT)))
            timers[-1].start()
        else:
            hook(lost)

    terminate = signal.signal(signal.SIGTERM, signal.default_int_handler)
    sys.unraisablehook = again
    try:
        yield
    finally:
        for timer in timers:
            timer.cancel()
        sys.unraisablehook = hook
        signal.signal(signal.SIGTERM, terminate)

"""Signals that end a run safely, and other work at once.

The first SIGINT, SIGTERM or SIGHUP asks a run to stop at its next wait; further ones do not disturb making safe; the
third, if SIGINT (Ctrl-C), ends the process at once.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_STOPPING = ("SIGINT", "SIGTERM", "SIGHUP")
_SIGNALS_TO_END_AT_ONCE = 3
_RESEND_AFTER_S = 0.05


@contextmanager
def stop_on_signals(request_stop: Callable[[str], None]) -> Iterator[None]:
    """Turn SIGINT, SIGTERM and SIGHUP into a request to stop, with its reason. Only for the main thread."""
    received = 0

    def ask(number: int, _frame: FrameType | None) -> None:
        nonlocal received
        received += 1
        if received >= _SIGNALS_TO_END_AT_ONCE and number == signal.SIGINT:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            raise KeyboardInterrupt
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
    """Let SIGTERM end the block as Ctrl-C does, with all clean-up, and let no interrupt be lost. Main thread only.

    Python ignores an exception raised in a finalizer (``sys.unraisablehook``); a lost KeyboardInterrupt is sent again.
    """
    hook = sys.unraisablehook
    # A shell starts background jobs with SIGINT ignored; SIGTERM is handled below in any case.
    ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    sent_again = signal.SIGTERM if ignored else signal.SIGINT
    timers: list[threading.Timer] = []
    main = threading.get_ident()

    def resend(lost: sys.UnraisableHookArgs) -> None:
        if issubclass(
            lost.exc_type, KeyboardInterrupt
        ):  # sent later: within this hook it would be lost again
            timers.append(threading.Timer(_RESEND_AFTER_S, signal.pthread_kill, (main, sent_again)))
            timers[-1].start()
        else:
            hook(lost)

    terminate = signal.signal(signal.SIGTERM, signal.default_int_handler)
    sys.unraisablehook = resend
    try:
        yield
    finally:
        for timer in timers:
            timer.cancel()
            timer.join()
        sys.unraisablehook = hook
        signal.signal(signal.SIGTERM, terminate)

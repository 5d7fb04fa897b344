"""The clock of the bench. Every wait of a run goes through it, so that a request to stop ends every wait.

The first SIGINT, SIGTERM or SIGHUP, or another thread, calls `BenchClock.request_stop`; the next ``sleep`` or ``check``
raises `Aborted`, or `Interrupted` after an interlock's ``interrupt``, until ``clear_interruption``. While devices are
made safe, the clock is ``shielded`` from both; the third signal, if SIGINT (Ctrl-C), ends the process at once; what
follows another SIGINT within a second is the same press.
``inactive_s`` grows where a driver hangs: the work neither waits, nor checks, nor reads the time. The time of a
`VirtualClock` passes only where the work waits.
"""

from __future__ import annotations

import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta
from types import FrameType
from typing import TypeVar

from bench.base.background import done_at_once, in_background
from bench.base.lost_output import errors_never_wait
from drivers.lateness import LatenessData, own_lateness

Result = TypeVar("Result")
_STOPPING = ("SIGINT", "SIGTERM", "SIGHUP")
_SIGNALS_TO_END_AT_ONCE = 3  # A second Ctrl-C is often pressed by impatience, a third on purpose
_ONE_PRESS_S = 1.0  # A key that is held repeats after .2 to 1 s, then many times a second
_RESEND_AFTER_S = 0.05  # A signal that came between a check and a wait is lost otherwise


class _Asked(Exception):
    """Somebody, named by ``reason``, has asked the work to end a wait."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)


class Aborted(_Asked):
    """The operator or the system, named by ``reason``, has asked the run to stop."""


class Interrupted(_Asked):
    """An interlock, named by ``reason``, has asked the work to pause; the work continues afterwards."""


class BenchClock:
    """The system's time, with a request to stop that ends every wait. The thread that makes it is the work's thread."""

    def __init__(self) -> None:
        self._woken = threading.Lock()  # a request releases it, the end of a wait takes it
        self._woken.acquire()
        self._stop: str | None = None
        self._failure: Exception | None = None
        self._interruption: str | None = None
        self._shields = 0
        self._asleep = False
        self._asleep_before_s = self.asleep_s()
        self._asked_s = time.monotonic()
        self._worker = threading.get_ident()

    def monotonic(self) -> float:
        """Return the time of the system's monotonic clock, s."""
        now_s = time.monotonic()
        # Other threads watch the work; their calls are no sign of life
        if threading.get_ident() == self._worker:
            self._asked_s = now_s
        return now_s

    def utc_now(self) -> datetime:
        """Return the system's time in UTC."""
        return datetime.now(UTC)

    def asleep_s(self) -> float:
        """Return for how long, s, this computer was suspended since it started; 0 where the system does not tell."""
        if not hasattr(time, "CLOCK_BOOTTIME"):
            return 0.0
        return time.clock_gettime(time.CLOCK_BOOTTIME) - time.clock_gettime(time.CLOCK_MONOTONIC)

    def sleep(self, seconds: float) -> None:
        """Wait, s (negative: 0). Unless shielded, `Aborted`, `Interrupted` or a failure ends the wait."""
        self._asleep = True
        try:
            if self._shields:
                time.sleep(max(0.0, seconds))
            elif self._wait(seconds):
                self._raise_request()
        finally:
            self._asked_s = time.monotonic()
            self._asleep = False

    def check(self) -> None:
        """Obey a request to stop or to pause between two pieces of work, unless the clock is shielded."""
        self._asked_s = time.monotonic()
        if self._is_requested and not self._shields:
            self._raise_request()

    @property
    def _is_requested(self) -> bool:
        return self._stop is not None or self._interruption is not None

    def _wait(self, seconds: float) -> bool:
        """Wait until somebody asks to end the wait, at most so long, s; return whether somebody has.

        A signal handler may ask at any line here: it would deadlock at the lock of an Event. A queue's ``get`` with a
        time limit never ends where that passes between its first and its second try (CPython 3.11 and 3.12).
        """
        deadline_s = time.monotonic() + seconds
        while not self._is_requested and (left_s := deadline_s - time.monotonic()) > 0:
            self._woken.acquire(timeout=left_s)
        if self._is_requested:
            self._wake()  # another thread that waits
        return self._is_requested

    def _wake(self) -> None:
        with suppress(RuntimeError):  # somebody else has asked before, and no wait has ended since
            self._woken.release()

    def in_parallel(self, work: Callable[[], Result]) -> Callable[[], Result]:
        """Begin work that goes on while this clock's worker does other things; return what waits for its result."""
        return in_background(work, "parallel work", left_alone=False).result

    def inactive_s(self) -> float:
        """Return for how long, s, the work has not waited, checked or read the time; 0 while it waits."""
        return 0.0 if self._asleep else max(0.0, time.monotonic() - self._asked_s)

    def lateness(self) -> LatenessData:
        """Return how late a computer that was busy or suspended woke this process; the first call begins to measure."""
        summary, asleep_s = own_lateness().summary(), self.asleep_s() - self._asleep_before_s
        lost_s, longest_s = summary["lost_s"] + asleep_s, max(summary["longest_s"], asleep_s)
        return {**summary, "lost_s": round(lost_s, 3), "longest_s": round(longest_s, 3)}

    def request_stop(self, reason: str) -> None:
        """Ask the run to stop at its next wait; the first request counts. Safe in a signal handler or thread."""
        if self._stop is None:
            self._stop = reason
            self._wake()

    def request_failure(self, error: Exception) -> None:
        """Ask the run to raise this error at its next wait, because a thread beside the work has failed."""
        if self._stop is None:
            self._failure = error
            self.request_stop(str(error))

    def interrupt(self, reason: str) -> None:
        """Ask the work to pause at its next wait. A request to stop takes precedence."""
        if self._interruption is None:
            self._interruption = reason
            self._wake()

    def clear_interruption(self) -> None:
        """Withdraw the request to pause. A request to stop remains."""
        self._interruption = None

    def _raise_request(self) -> None:
        if self._failure is not None:
            raise self._failure
        if self._stop is not None:
            raise Aborted(self._stop)
        if self._interruption is not None:
            raise Interrupted(self._interruption)

    @contextmanager
    def shielded(self) -> Iterator[None]:
        """Let no request end the waits in this block, in which the devices are made safe."""
        self._shields += 1
        try:
            yield
        finally:
            self._shields -= 1


class VirtualClock(BenchClock):
    """A clock whose time passes only where the work waits, so that a simulated night takes only its computing time.

    >>> clock = VirtualClock(datetime(2026, 3, 1, 22, tzinfo=UTC))
    >>> clock.sleep(3600)
    >>> f"{clock.utc_now():%H:%M}", clock.monotonic()
    ('23:00', 3600.0)
    """

    def __init__(self, begin: datetime) -> None:
        super().__init__()
        self._begin = begin.astimezone(UTC)
        self._now_s = 0.0

    def monotonic(self) -> float:
        """Return the virtual time, s since ``begin``."""
        return self._now_s

    def utc_now(self) -> datetime:
        """Return the virtual time in UTC."""
        return self._begin + timedelta(seconds=self._now_s)

    def sleep(self, seconds: float) -> None:
        """Advance the virtual time; returns at once. A negative duration is 0."""
        self.check()
        self._now_s += max(0.0, seconds)

    def in_parallel(self, work: Callable[[], Result]) -> Callable[[], Result]:
        """See `BenchClock.in_parallel`. The work is done at once; its virtual time passes beside that of the worker."""
        begin_s = self._now_s
        with self.shielded():
            outcome = done_at_once(work)
        end_s, self._now_s = self._now_s, begin_s

        def result() -> Result:
            self.sleep(end_s - self._now_s)
            return outcome.result()

        return result

    def asleep_s(self) -> float:
        """See `BenchClock.asleep_s`."""
        return 0.0

    def lateness(self) -> LatenessData:
        """See `BenchClock.lateness`."""
        return {}


@contextmanager
def stop_on_signals(
    request_stop: Callable[[str], None], *, received: int = 0, monotonic: Callable[[], float] = time.monotonic
) -> Iterator[None]:
    """Turn SIGINT, SIGTERM and SIGHUP into a request to stop, with its reason. Only for the main thread.

    The third SIGINT ends the process at once; ``received`` is how many signals came before.
    """
    pressed_s = -math.inf

    def ask(number: int, _frame: FrameType | None) -> None:
        nonlocal received, pressed_s
        if number == signal.SIGINT:
            before_s, pressed_s = pressed_s, monotonic()
            if pressed_s - before_s < _ONE_PRESS_S:
                return
        received += 1
        if received >= _SIGNALS_TO_END_AT_ONCE and number == signal.SIGINT:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            raise KeyboardInterrupt
        name = signal.Signals(number).name
        request_stop("stopped by Ctrl-C" if number == signal.SIGINT else f"{name} received")

    with stopping_signals(ask), errors_never_wait():
        yield


@contextmanager
def stopping_signals(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Let a function handle SIGINT, SIGTERM and SIGHUP during the block; not SIGHUP under nohup. Main thread only."""
    numbers = [getattr(signal, name) for name in _STOPPING if hasattr(signal, name)]
    heard = (n for n in numbers if n == signal.SIGINT or signal.getsignal(n) is not signal.SIG_IGN)
    before = {number: signal.signal(number, handler) for number in heard}
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)


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
        # Sent later: within this hook it would be lost again
        if issubclass(lost.exc_type, KeyboardInterrupt):
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

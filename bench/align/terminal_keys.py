"""Keys that control a session in a terminal: light, small steps of the stage, home, and a stop that waits for nothing.

Keys are read one by one while the terminal shows the figures. Where the input is no terminal, there are no keys. This
module calls the session and moves nothing itself.
"""

from __future__ import annotations

import os
import select
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from typing import Final

from bench.align.session import Session
from bench.base.failure import FORESEEN, Failure

STEPS_DEG: Final = (0.01, 0.1, 0.5, 1.0, 5.0)
LEVELS_PERCENT: Final = (1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 50.0, 70.0, 100.0)
HELP: Final = (
    "Keys: L light on or off; + and - its level; arrows turn pan and tilt by the step; , and . change the step; "
    "H twice homes; O opens again what is not open; space stops; Q ends."
)
_LATE_S: Final = 10.0
"""Longest wait of a key for a light that is being opened, s."""
_ARROWS: Final[Mapping[bytes, tuple[str, int]]] = {
    b"\x1b[C": ("pan", 1),
    b"\x1b[D": ("pan", -1),
    b"\x1b[A": ("tilt", 1),
    b"\x1b[B": ("tilt", -1),
}
_LEVELS: Final[Mapping[bytes, int]] = {b"+": 1, b"=": 1, b"-": -1, b"_": -1}
_STOPS: Final = (b" ", b"\x1b")
_NOTICE_S: Final = 5.0
_SURE_S: Final = 3.0
_LOOK_S: Final = 0.05


class TerminalKeys:
    """What the keys do.

    monotonic: Returns the time of a monotonic clock, s.
    """

    def __init__(
        self, session: Session, end: Callable[[], None], monotonic: Callable[[], float] = time.monotonic
    ) -> None:
        self._session = session
        self._end = end
        self._monotonic = monotonic
        self._step = 2
        self._home_asked_s = -_SURE_S
        self._notice, self._notice_s = "", -_NOTICE_S
        self._closed = threading.Event()
        self._work = ThreadPoolExecutor(1, thread_name_prefix="align-keys")

    def notice(self) -> str:
        """Return what the last key did, for some seconds.

        Returns: A sentence; empty if the last key was pressed long ago.
        """
        return self._notice if self._monotonic() - self._notice_s < _NOTICE_S else ""

    def press(self, key: bytes) -> None:
        """Do what a key asks for. A stop is sent at once; anything else after what was asked for before."""
        if key in _STOPS:
            threading.Thread(target=self._do, args=(self._stop,), daemon=True).start()
        elif key in _ARROWS:
            axis, sign = _ARROWS[key]
            step_deg = sign * STEPS_DEG[self._step]
            self._work.submit(self._do, lambda: self._jog(axis, step_deg))
        elif key.lower() == b"l":
            self._work.submit(self._do, self._light)
        elif key in _LEVELS:
            self._work.submit(self._do, lambda: self._level(_LEVELS[key]))
        elif key.lower() == b"h":
            self._home()
        elif key in (b",", b"."):
            self._step = min(max(self._step + (1 if key == b"." else -1), 0), len(STEPS_DEG) - 1)
            self._say(f"The step is {STEPS_DEG[self._step]:g} degrees.")
        elif key.lower() == b"o":
            self._work.submit(self._do, self._open_again)
        elif key.lower() == b"q":
            self._end()

    def close(self) -> None:
        """Do no more."""
        self._closed.set()
        self._work.shutdown(wait=False, cancel_futures=True)

    def _stop(self) -> str:
        self._session.stop("by a key")
        return "The stage was stopped."

    def _jog(self, axis: str, step_deg: float) -> str:
        goal_deg = self._session.jog(axis, step_deg)[axis]
        return f"{axis} turns to {goal_deg:.3f} degrees."

    def _light(self) -> str:
        self._wait_open()
        on = not self._session.bench.light.reading.on
        self._session.light(on=on)
        return f"The light is {'on' if on else 'off'}."

    def _level(self, way: int) -> str:
        self._wait_open()
        now = self._session.bench.light.reading.flicker.level_percent
        others = [level for level in LEVELS_PERCENT if (level > now if way > 0 else level < now)]
        if not others:
            return f"The light's level is {now:g} %; there is no {'higher' if way > 0 else 'lower'} one."
        level = others[0 if way > 0 else -1]
        self._session.light(level_percent=level)
        return f"The light's level is {level:g} %{'' if self._session.bench.light.reading.on else '; it is off'}."

    def _wait_open(self) -> None:
        """Wait until the devices are open. A motion does not wait: it is refused until then."""
        while not self._session.is_open and not self._closed.wait(_LOOK_S):
            pass
        self._session.wait_for_devices(_LATE_S)

    def _open_again(self) -> str:
        failure = self._session.reopen()
        return failure.message if failure is not None else "What was not open is being opened."

    def _start_homing(self) -> str:
        self._session.home()
        return "The stage is homing."

    def _home(self) -> None:
        now_s = self._monotonic()
        if now_s - self._home_asked_s < _SURE_S:
            self._home_asked_s = -_SURE_S
            self._work.submit(self._do, self._start_homing)
        else:
            self._home_asked_s = now_s
            self._say("Homing turns the axes over a large part of their range. Press H again to do it.")

    def _do(self, action: Callable[[], str]) -> None:
        """Do something and show what it says; an error is shown too."""
        try:
            self._say(action())
        except FORESEEN as error:
            self._say(Failure.of(error).message)

    def _say(self, text: str) -> None:
        self._notice, self._notice_s = text, self._monotonic()


@contextmanager
def keys_of_terminal(keys: TerminalKeys) -> Iterator[bool]:
    """Read keys from the terminal while the block runs.

    keys: What they do; it is closed at the end.
    Yields: Whether there are keys: standard input is a terminal that can send single keys.
    """
    closing = threading.Event()
    with suppress(ImportError):
        import termios
        import tty

        if sys.stdin.isatty():
            number = sys.stdin.fileno()
            before = termios.tcgetattr(number)
            # Not the default, which would drop the keys that were pressed before.
            tty.setcbreak(number, termios.TCSANOW)
            reader = threading.Thread(target=_read, args=(number, keys, closing), daemon=True)
            reader.start()
            try:
                yield True
            finally:
                closing.set()
                reader.join(timeout=1.0)
                termios.tcsetattr(number, termios.TCSADRAIN, before)
                keys.close()
            return
    try:
        yield False
    finally:
        keys.close()


def _read(number: int, keys: TerminalKeys, closing: threading.Event) -> None:
    while not closing.is_set():
        if not select.select([number], [], [], 0.1)[0]:
            continue
        try:
            data = os.read(number, 64)
        except OSError:  # the terminal was closed
            return
        if not data:
            return
        for key in split_keys(data):
            keys.press(key)


def split_keys(data: bytes) -> list[bytes]:
    r"""Split what a terminal has sent into keys.

    Examples
    --------
    >>> split_keys(b"l\x1b[A\x1b[A ")
    [b'l', b'\x1b[A', b'\x1b[A', b' ']
    """
    found = []
    while data:
        length = 3 if data[:2] in (b"\x1b[", b"\x1bO") and len(data) >= 3 else 1
        key = data[:length]
        found.append(key.replace(b"\x1bO", b"\x1b["))
        data = data[length:]
    return found

"""Orders typed on a process's standard input, a line each, every one answered by a line of JSON.

Knows lines and answers; what an order means is the caller's.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Callable, Mapping
from typing import Any

from simulators.errors import SimulatorError


def answer(content: Mapping[str, Any]) -> None:
    """Print one line of JSON at once."""
    sys.stdout.write(json.dumps(content) + "\n")
    sys.stdout.flush()


def allow_background() -> None:
    """Have a process in the background of a terminal go on without orders, instead of being stopped for reading.

    To be called from the main thread, before orders are taken.
    """
    if hasattr(signal, "SIGTTIN"):
        signal.signal(signal.SIGTTIN, signal.SIG_IGN)


def take_orders(carry_out: Callable[[str], Mapping[str, Any]], ended: Callable[[], None]) -> None:
    """Take orders until standard input ends.

    Parameters
    ----------
    carry_out
        Carries one order out and says what was done; what it raises of ours, or ValueError, is the answer.
    ended
        Called at the end of standard input.
    """
    waiting = b""
    while heard := _read():
        *lines, waiting = (waiting + heard).split(b"\n")
        for line in lines:
            text = line.decode("utf-8", "replace").strip()
            if not text:
                continue
            try:
                answer({"ok": True, **carry_out(text)})
            except (SimulatorError, ValueError) as error:
                answer({"ok": False, "error": str(error)})
    ended()


def _read() -> bytes:
    """Read standard input; nothing where there is none to be read."""
    try:
        # Not sys.stdin: its lock would be held by this thread while the interpreter shuts down.
        return os.read(0, 4096)
    except OSError:
        return b""

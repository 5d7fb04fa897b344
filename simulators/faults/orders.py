"""Orders on a process's standard input: one order a line, each answered by one line of JSON.

The caller decides what an order means.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Callable, Mapping
from typing import Any

from simulators.errors import SimulatorError


def print_answer(content: Mapping[str, Any]) -> None:
    """Write one line of JSON to standard output, and flush it."""
    sys.stdout.write(json.dumps(content) + "\n")
    sys.stdout.flush()


def allow_background() -> None:
    """Let a background process of a terminal run on without orders.

    Otherwise the terminal would stop it when it reads its standard input. Call this function
    from the main thread, before orders are read.
    """
    if hasattr(signal, "SIGTTIN"):
        signal.signal(signal.SIGTTIN, signal.SIG_IGN)


def take_orders(carry_out: Callable[[str], Mapping[str, Any]], ended: Callable[[], None]) -> None:
    """Read orders until standard input ends.

    carry_out: Carries out one order and returns what was done. If it raises SimulatorError or ValueError, the
      answer is the error's text.
    """
    waiting = b""
    while heard := _read():
        *lines, waiting = (waiting + heard).split(b"\n")
        for line in lines:
            text = line.decode("utf-8", "replace").strip()
            if not text:
                continue
            try:
                print_answer({"ok": True, **carry_out(text)})
            except (SimulatorError, ValueError) as error:
                print_answer({"ok": False, "error": str(error)})
    ended()


def _read() -> bytes:
    """Read from standard input; return nothing if it cannot be read."""
    try:
        # Not sys.stdin: this thread would hold its lock while the interpreter shuts down.
        return os.read(0, 4096)
    except OSError:
        return b""

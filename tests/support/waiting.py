"""Waits for what another thread or process does."""

import time
from collections.abc import Callable
from typing import Any


def wait_until(holds: Callable[[], Any], within_s: float = 5.0, what: str = "it") -> None:
    """Wait until something holds; fail if it does not in time."""
    end_s = time.monotonic() + within_s
    while not holds():
        assert time.monotonic() < end_s, f"{what} did not happen within {within_s:g} s"
        time.sleep(0.005)

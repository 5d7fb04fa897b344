"""The side of a port that a driver sees, over any model of a device in memory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class PeerPort:
    """Hands out what a model has answered. `spoil` may change a reply, `before` sees each request.

    A model gives `write`, notes in `sent` what it was told, and adds its answers to `ready`.
    """

    def __init__(self) -> None:
        self.ready = b""
        self.sent: list[Any] = []
        self.closed = False
        self.spoil: Callable[[bytes], bytes] = lambda reply: reply
        self.before: Callable[[str], None] = lambda request: None

    def read(self, timeout_s: float) -> bytes:
        data, self.ready = self.ready, b""
        return data

    def close(self) -> None:
        self.closed = True

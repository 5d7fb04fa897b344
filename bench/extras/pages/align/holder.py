"""Which page holds the controls: one at a time, and any page may take them over.

Each open page (tab) has an id that it makes itself, and a heartbeat. A stop needs no controls: any page, and
Ctrl-C, may stop the stage at any time.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

from bench.base.errors import ControlRefused

BEAT_LIMIT_S = 0.75
"""Age of the last heartbeat from which a motion of the page is stopped, s. A page sends one every 0.2 s."""
_FREE_S = 5.0  # Age from which another page gets the controls unasked: a busy computer beats late


class Holder:
    """The page that holds the controls."""

    def __init__(self, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._monotonic = monotonic
        self._lock = threading.Lock()
        self._page = ""
        self._beat_s = -math.inf

    @property
    def page(self) -> str:
        """Id of the page that holds the controls; empty if none does."""
        return "" if self._age_s() > _FREE_S else self._page

    @property
    def is_lost(self) -> bool:
        """Whether the page that had the controls last has closed or gone silent; False if no page had them."""
        return bool(self._page) and self._age_s() > BEAT_LIMIT_S

    def enter(self, page: str) -> None:
        """Note that a page has opened. It gets the controls if no page holds them."""
        with self._lock:
            if self.page in ("", page):
                self._take(page)

    def beat(self, page: str) -> None:
        """Note a heartbeat of a page."""
        with self._lock:
            if page == self._page:
                self._beat_s = self._monotonic()

    def take(self, page: str) -> bool:
        """Give the controls to a page; return whether another one had them."""
        with self._lock:
            had = self.page not in ("", page)
            self._take(page)
            return had

    def leave(self, page: str) -> bool:
        """Note that a page has closed; return whether it had the controls."""
        with self._lock:
            if page != self._page:
                return False
            self._beat_s = -math.inf
            return True

    def require(self, page: str) -> None:
        """Check that a page holds the controls; it gets them if nobody does, else ControlRefused is raised."""
        with self._lock:
            if self.page not in ("", page):
                raise ControlRefused(
                    "Another page has the controls. Nothing was changed.",
                    remedy="Press Take over to get them.",
                )
            self._take(page)

    def _take(self, page: str) -> None:
        self._page, self._beat_s = page, self._monotonic()

    def _age_s(self) -> float:
        return self._monotonic() - self._beat_s

"""Who holds the controls of the align page: one page at a time, and any page may take them over.

Each open page (tab) has an id that it makes itself, a number that people read, and a heartbeat. A stop
needs no controls: any page, and Ctrl-C, may stop the stage at any time. The module moves nothing and
knows no device.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from bench.base.errors import ControlRefused

BEAT_LIMIT_S = 0.75
"""Age of the last heartbeat from which a page counts as lost, s. A page sends a heartbeat every 0.2 s."""
_FORGET_S = 600.0  # A computer that slept so long opens its page anew
_MOST_PAGES = 200  # Far more than a bench has; a loop of a broken client must not fill the memory


@dataclass
class _Page:
    number: int
    what: str
    streams: int = 0
    beat_s: float = 0.0


class Owners:
    """The open pages, and which of them holds the controls."""

    def __init__(
        self, on_change: Callable[[], None], monotonic: Callable[[], float] = time.monotonic
    ) -> None:
        self._on_change = on_change
        self._monotonic = monotonic
        self._lock = threading.Lock()
        self._pages: dict[str, _Page] = {}
        self._holder = ""
        self._numbered = 0

    @property
    def holder(self) -> str:
        """Id of the page that holds the controls; empty if none does."""
        return self._holder

    def enter(self, page: str, what: str) -> None:
        """Note that a page has opened a stream. The first open page gets the controls."""
        with self._lock:
            shown = self._page(page, what)
            shown.streams += 1
            if not self._is_open(self._holder):
                self._holder = page
        self._on_change()

    def leave(self, page: str) -> bool:
        """Note that a stream of a page has closed; True if it was the page's last one."""
        with self._lock:
            shown = self._pages.get(page)
            if shown is None:
                return False
            shown.streams = max(0, shown.streams - 1)
            gone = shown.streams == 0
        self._on_change()
        return gone

    def beat(self, page: str) -> None:
        """Note a heartbeat of a page."""
        with self._lock:
            shown = self._pages.get(page)
            if shown is not None:
                shown.beat_s = self._monotonic()

    def take(self, page: str, what: str = "") -> None:
        """Give the controls to a page."""
        with self._lock:
            self._page(page, what)
            self._holder = page
        self._on_change()

    def require(self, page: str) -> None:
        """Check that a page holds the controls; it gets them if nobody does, else ControlRefused is raised."""
        with self._lock:
            if page == self._holder:
                return
            if not self._is_open(self._holder):
                self._page(page, "")
                self._holder = page
                return
            name = _name(self._pages[self._holder])
        raise ControlRefused(
            f"{name} has the controls. Nothing was changed.", remedy="Press Take over to get them."
        )

    def is_lost(self, page: str) -> bool:
        """Return whether a page has closed or gone silent; True also for a page that is not known."""
        with self._lock:
            shown = self._pages.get(page)
            return shown is None or self._monotonic() - shown.beat_s > BEAT_LIMIT_S

    def name(self, page: str) -> str:
        """Return how a page is called on other pages."""
        with self._lock:
            shown = self._pages.get(page)
            return _name(shown) if shown is not None else "A page"

    def as_data(self) -> dict[str, Any]:
        """Return ``holder``: id, and ``pages``: number and description of each open page by id."""
        with self._lock:
            return {
                "holder": self._holder if self._is_open(self._holder) else "",
                "pages": {
                    page: {"number": shown.number, "what": shown.what, "name": _name(shown)}
                    for page, shown in self._pages.items()
                    if shown.streams
                },
            }

    def _page(self, page: str, what: str) -> _Page:
        """Return a page, new if it is not known; the lock is held. Pages closed long ago are forgotten."""
        now_s = self._monotonic()
        if page not in self._pages:
            old = [
                p
                for p, old_page in self._pages.items()
                if not old_page.streams and now_s - old_page.beat_s > _FORGET_S
            ]
            for old_page in old:
                del self._pages[old_page]
            if len(self._pages) >= _MOST_PAGES:
                raise ControlRefused("Too many pages are open.", remedy="Close some of them.")
            self._numbered += 1
            self._pages[page] = _Page(self._numbered, what)
        shown = self._pages[page]
        shown.what = what or shown.what
        shown.beat_s = now_s
        return shown

    def _is_open(self, page: str) -> bool:
        shown = self._pages.get(page)
        return shown is not None and shown.streams > 0


def _name(page: _Page) -> str:
    return f"Page {page.number}" + (f" ({page.what})" if page.what else "")

"""A headless Chromium, and a tab of it for tests of the align page."""

import os
import re
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.support.waiting import wait_until

CHROMIUM = os.environ.get("STARBENCH_CHROMIUM", "/usr/bin/chromium")
FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip


@contextmanager
def running_chromium():
    """Start Chromium, and end it with the block; the test is skipped where there is none."""
    if not Path(CHROMIUM).exists():
        pytest.skip(f"no Chromium at {CHROMIUM}")
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


class Tab:
    """One tab of the browser; it notes errors of scripts and every host that it asks."""

    def __init__(self, chromium, url, width=1280):
        self.tab = chromium.new_page(viewport={"width": width, "height": 900})
        self.errors, self.hosts = [], set()
        self.tab.on("pageerror", lambda error: self.errors.append(str(error)))
        self.tab.on(
            "request", lambda request: self.hosts.add(re.sub(r"^blob:", "", request.url).split("/")[2])
        )
        self.tab.goto(url)

    def wait(self, script, timeout_s=10.0):
        """Wait until a script of the page is true."""
        wait_until(lambda: self.tab.evaluate(script), timeout_s)

    def text(self, selector):
        """Return the text of an element."""
        return self.tab.inner_text(selector)

    def wait_text(self, selector, words, timeout_s=10.0):
        """Wait until an element shows words."""
        wait_until(lambda: words in self.text(selector), timeout_s)

    def close(self):
        """Close the tab; no script may have failed."""
        self.tab.close()
        assert self.errors == []

"""A headless Chromium."""

import pytest
from align_browser import running_chromium


@pytest.fixture(scope="module")
def chromium():
    with running_chromium() as browser:
        yield browser

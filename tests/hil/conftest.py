"""A headless Chromium, the configuration folder of a module's runs, and a clock that only waits turn."""

import pytest
from align_browser import running_chromium

from tests.hil.direct_stages import VirtualClock


@pytest.fixture(scope="module")
def chromium():
    with running_chromium() as browser:
        yield browser


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    return tmp_path_factory.mktemp("home")


@pytest.fixture
def clock():
    return VirtualClock()

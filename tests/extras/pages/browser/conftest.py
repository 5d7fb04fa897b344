"""A headless Chromium, and the configuration folder of a module's runs."""

from tests.hil.conftest import chromium, home  # noqa: F401

"""A run under way, as the panel shows it."""

import pytest
from journals import MadeRun


@pytest.fixture
def run(tmp_path):
    run = MadeRun(tmp_path / "runs" / "run7").begin()
    run.record(1)
    return run

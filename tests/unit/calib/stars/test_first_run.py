"""The process that compiles the loops finds the same stars, to the last bit, as those that load the compiled ones."""

import os
import sys
from pathlib import Path

import pytest
from running import python

ROOT = Path(__file__).parents[4]
CODE = """
import hashlib
from tests.unit.calib.stars.test_detect import TARGET, detect_view, drawn

found = [detect_view(drawn(roll=roll)[1], TARGET) for roll in (0, 12, 31)]
print(hashlib.sha256(b"".join(view.points_px.tobytes() for view in found)).hexdigest())
"""


@pytest.mark.slow
def test_stars_of_the_first_run_after_an_installation_are_those_of_later_runs(tmp_path):
    """Reordered sums of a loop that is compiled alone differ from those of the same loop in another."""
    words = {"cwd": ROOT, "NUMBA_CACHE_DIR": tmp_path, "PYTHONPATH": os.pathsep.join(sys.path)}
    first, second = (python("-c", CODE, **words).stdout for _ in range(2))
    assert any(tmp_path.rglob("*.nbi"))
    assert first == second

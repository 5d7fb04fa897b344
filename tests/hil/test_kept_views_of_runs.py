"""The views that a run keeps are those that `calibrate` would find in its recordings."""

import pytest
from quick_runs import THREE, quick_words
from running import called

from bench.measure.kept_views import FOLDER, KeptViews, pack_view, view_key
from bench.solve.offline_options import OfflineOptions
from bench.solve.view_sources import view_sources

pytestmark = pytest.mark.slow


def test_views_of_a_run_are_kept_and_equal_to_those_found_again(tmp_path, monkeypatch):
    monkeypatch.setenv("STARBENCH_HOME", str(tmp_path / "home"))
    called(*quick_words(tmp_path, THREE, seed=1), home=tmp_path / "home")
    # Gates of a run need it, a calibration does not.
    monkeypatch.setattr("bench.measure.measure.motion_px", None)
    kept = KeptViews(tmp_path / "home" / FOLDER)
    for source in view_sources(tmp_path / "run", OfflineOptions()):
        key = view_key(source.attempt.stored["sha256"], source.decided_by)
        assert pack_view(kept.read(key), key) == pack_view(source.read(), key)

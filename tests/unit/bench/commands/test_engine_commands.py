"""The engine at the command line: passports, forecasts, on views made here."""

import json
from datetime import UTC, datetime

import numpy as np
import pytest
from calling import out_of
from expected_stars import expected_views, write_points

from bench.base.clock import VirtualClock
from bench.solve.forecasts import expected_bench
from bench.stations.station import load_station

pytestmark = pytest.mark.usefixtures("calibrated_once")

POSES = [(-6, 2), (6, 2), (0, -3), (3, 3), (-4, -2)]


@pytest.fixture(scope="module")
def points(tmp_path_factory):
    """Point files of five imagined views, every third star with 0.03 px of noise; and the truth they were made of."""
    poses = [(f"view{number}", *angles) for number, angles in enumerate(POSES, 1)]
    views = expected_views(poses, sigma_px=0.03, seed=4)
    return write_points(tmp_path_factory.mktemp("points"), views, every=3), expected_bench(
        load_station("simulated_ideal")
    )


def test_with_a_passport_one_view_is_enough(capsys, points, tmp_path):
    folder, bench = points
    file = tmp_path / "collimator.json"
    conditions = ("--collimator", "C7", "--temperature", 21.5)
    out_of(capsys, "passport", "make", folder, "--image-size", "1280x720", "-o", file, *conditions)
    shown = out_of(capsys, "passport", "show", file)
    assert all(fact in shown for fact in ("collimator: C7", "temperature_c: 21.5", "from 5 views: view1"))
    held = json.loads(out_of(capsys, "passport", "show", file, "--json"))
    assert held["names"][:3] == ["x", "y", "r"]
    assert np.array(held["covariance"]).shape == (len(held["names"]), len(held["names"]))
    assert held["conditions"]["made_utc"].startswith("20")
    assert held["conditions"]["model"] == "joint"
    sizes = ("--image-size", "1280x720", "--json")
    alone = json.loads(out_of(capsys, "calibrate", folder / "view4.csv", "--passport", file, *sizes))
    assert abs(alone["camera"]["fx"] - bench.camera.fx) < 3 * alone["sigma"]["fx"]


def test_a_capture_shorter_than_its_journal_states_is_refused(tmp_path):
    from bench.record.journal import Journal
    from bench.solve.view_sources import refuse_truncated
    from drivers.errors import RecordingCorrupt

    path = tmp_path / "captures" / "pose-001-attempt-1.raw"
    path.parent.mkdir()
    path.write_bytes(b"% format EVT3;height=720;width=1280\n% end\n" + bytes(8))
    size = path.stat().st_size
    now = datetime(2026, 3, 1, tzinfo=UTC)
    with Journal.create(tmp_path / "journal.jsonl", VirtualClock(now)) as journal:
        journal.append(
            "capture_stored", capture="captures/pose-001-attempt-1.raw", size=size, sha256="0" * 64
        )
    refuse_truncated(path)
    path.write_bytes(path.read_bytes()[:-2])
    with pytest.raises(RecordingCorrupt, match=f"incomplete: {size} bytes were recorded"):
        refuse_truncated(path)

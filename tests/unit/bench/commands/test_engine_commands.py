"""The engine at the command line: passports, forecasts, on views made here."""

import json
from datetime import UTC, datetime

import cv2
import numpy as np
import pytest
from calling import out_of, refusal
from expected_stars import expected_views, write_points

from bench.plan.plan import load_documents, make_plan
from bench.solve.expectations import expected_uncertainty
from bench.solve.forecasts import expected_bench, suggest_poses
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


def test_values_stand_in_columns(capsys, points):
    output = out_of(capsys, "calibrate", points[0], "--image-size", "1280x720")
    values = [line for line in output.splitlines() if "±" in line and line.startswith("  ")]
    assert any(line.startswith("  radial_4 ") for line in values)
    assert len({line.index("±") for line in values}) == 1


CAMERA_INFO = """
image_width: 1280
image_height: 720
camera_name: mine
camera_matrix: {{rows: 3, cols: 3, data: [{f}, 0, {cx}, 0, {f}, {cy}, 0, 0, 1]}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: [{k1}, {k2}, 0, 0, 0]}}
"""


@pytest.fixture
def camera_info(points, tmp_path):
    """The true camera of the points as ROS writes it; with a longer lens, if one wishes."""

    def write(longer=1.0):
        true = points[1].camera
        lens = {name: true.distortion.get(name, 0.0) for name in ("k1", "k2")}
        text = CAMERA_INFO.format(f=longer * true.fx, cx=true.cx, cy=true.cy, **lens)
        (tmp_path / "camera_info.yaml").write_text(text)
        return tmp_path / "camera_info.yaml"

    return write


def test_a_camera_that_did_not_change_is_right_within_u(capsys, points, camera_info):
    shown = out_of(capsys, "check", points[0], "--image-size", "1280x720", "--calibration", camera_info())
    assert shown.startswith("RIGHT within U everywhere on the sensor")
    assert "can stay unseen" in shown
    assert "ROS's camera_info states no uncertainty" in shown


def test_a_lens_that_became_longer_is_told_with_its_place_and_cause(capsys, points, camera_info):
    words = ["check", points[0], "--image-size", "1280x720", "--calibration", camera_info(longer=1.01)]
    answer = json.loads(out_of(capsys, *words, "--json", status=1))
    assert (answer["right"], answer["cause"]) == (False, "scale")
    assert max(region["normalised"] for region in answer["regions"]) > 1
    assert "NOT RIGHT" in (shown := out_of(capsys, *words, status=1))
    assert "A change of scale explains it" in shown


def test_one_view_without_a_known_collimator_says_what_it_can_see(capsys, points, camera_info, tmp_path):
    words = ["check", points[0] / "view1.csv", "--image-size", "1280x720", "--calibration"]
    shown = out_of(capsys, *words, camera_info())
    assert shown.startswith(
        "One view without a known collimator: judged is only what no other pose explains."
    )
    assert "RIGHT as far as this view can tell" in shown
    assert "A change of one value alone would be seen from: scale" in shown
    answer = json.loads(out_of(capsys, *words, camera_info(), "--json"))
    assert (answer["one_view"], answer["right"]) == (True, True)
    assert answer["seen_from"]["scale"] > 0.001
    true = points[1].camera  # a file without a size, as OpenCV's tutorial writes it
    np.savez(tmp_path / "calib.npz", mtx=true.matrix, dist=true.coefficients[:5])
    assert "RIGHT as far as" in out_of(capsys, *words, tmp_path / "calib.npz")


def test_a_rig_without_a_common_pose_is_refused_before_any_calibration(capsys, points, tmp_path, monkeypatch):
    for file in points[0].iterdir():
        (tmp_path / f"other-{file.name}").write_bytes(file.read_bytes())
    monkeypatch.setattr("bench.solve.solution.calibrate", lambda *_: pytest.fail("calibrated"))
    message = refusal(capsys, "rig", points[0], tmp_path, "--image-size", "1280x720")
    assert "share no pose: view1, view2, view3, view4, view5 and other-view1," in message


def test_with_a_passport_one_view_is_enough_and_the_focal_length_is_more_certain(capsys, points, tmp_path):
    folder, bench = points
    file = tmp_path / "collimator.json"
    conditions = ("--collimator", "C7", "--temperature", 21.5)
    out_of(capsys, "passport", "make", folder, "--image-size", "1280x720", "-o", file, *conditions)
    shown = out_of(capsys, "passport", "show", file)
    assert "collimator: C7" in shown
    assert "temperature_c: 21.5" in shown
    assert "from 5 views: view1, view2, view3, view4, view5" in shown
    held = json.loads(out_of(capsys, "passport", "show", file, "--json"))
    assert held["names"][:3] == ["x", "y", "r"]
    assert np.array(held["covariance"]).shape == (len(held["names"]), len(held["names"]))
    assert held["conditions"]["made_utc"].startswith("20")
    assert held["conditions"]["model"] == "joint"
    sizes = ("--image-size", "1280x720", "--json")
    alone = json.loads(out_of(capsys, "calibrate", folder / "view4.csv", "--passport", file, *sizes))
    assert abs(alone["camera"]["fx"] - bench.camera.fx) < 3 * alone["sigma"]["fx"]
    without = json.loads(out_of(capsys, "calibrate", folder, "--views", "1,2,3", *sizes))
    with_it = json.loads(out_of(capsys, "calibrate", folder, "--views", "1,2,3", "--passport", file, *sizes))
    assert with_it["sigma"]["fx"] < without["sigma"]["fx"]


def test_a_passport_is_never_overwritten_and_only_a_passport_is_read(capsys, points, tmp_path):
    file = tmp_path / "c.json"
    folder, _ = points
    words = ("passport", "make", folder, "--image-size", "1280x720", "-o", file)
    file.write_text("{}")
    out_of(capsys, *words, status=2)
    assert file.read_text() == "{}"
    for name, text in (("a.json", "{}"), ("b.json", "no json"), ("d.json", "[1, 2]")):
        (tmp_path / name).write_text(text)
        out_of(capsys, "passport", "show", tmp_path / name, status=2)
    out_of(capsys, "passport", "show", tmp_path / "none", status=2)


def test_a_plan_shows_the_expected_uncertainty_and_suggests_poses(capsys):
    answer = json.loads(out_of(capsys, "plan", "three_pose", "-s", "simulated", "--suggest", "2", "--json"))
    assert 0.1 < answer["expected"]["sigma"]["fx"] < 10
    assert len(answer["suggested"]) == 2
    planned = make_plan(*load_documents("three_pose", "simulated"))
    limits = planned.station.value.axes
    for pose in suggest_poses(planned, 2):
        for axis, words in limits.items():
            assert words.limits_deg[0] <= pose.angles_deg[f"{axis}_deg"] <= words.limits_deg[1]
    nine = expected_uncertainty(make_plan(*load_documents("nine_pose", "simulated")))
    assert nine is not None
    assert nine.forecast.projection_map.worst_px < answer["expected"]["worst_px"]


@pytest.mark.parametrize("kind", ["metavision", "hdf5", "numpy"])
def test_a_recording_is_converted_completely_and_never_overwrites_a_file(
    capsys, evk4_recording, tmp_path, kind
):
    from imported import import_events

    raw = evk4_recording
    assert "82469 events, 2 triggers" in out_of(capsys, "convert", raw, tmp_path / "out", "--as", kind)
    assert len(import_events(tmp_path / "out").events.t) == 82_469
    out_of(capsys, "convert", raw, tmp_path / "out", "--as", kind, status=2)


def test_a_capture_shorter_than_its_journal_states_is_refused(tmp_path):
    from bench.record.journal import Journal
    from bench.solve.view_sources import refuse_truncated
    from drivers.errors import RecordingCorrupt

    path = tmp_path / "captures" / "pose-001-attempt-1.raw"
    path.parent.mkdir()
    path.write_bytes(b"% format EVT3;height=720;width=1280\n% end\n" + bytes(8))
    size = path.stat().st_size
    now = datetime(2026, 3, 1, tzinfo=UTC)
    with Journal.create(tmp_path / "journal.jsonl", utc_now=lambda: now, monotonic=lambda: 0.0) as journal:
        journal.append(
            "capture_stored", capture="captures/pose-001-attempt-1.raw", size=size, sha256="0" * 64
        )
    refuse_truncated(path)
    path.write_bytes(path.read_bytes()[:-2])
    with pytest.raises(RecordingCorrupt, match=f"incomplete: {size} bytes were recorded"):
        refuse_truncated(path)


LENSES = {
    "tangential": ("plumb_bob", [-0.21, 0.11, 4e-4, -6e-4, 0.0]),
    "fisheye": ("equidistant", [-0.03, 0.011, -0.006, 0.002]),
}


@pytest.mark.parametrize(("model", "lens"), LENSES.values(), ids=LENSES)
def test_a_right_camera_is_right_by_views_of_a_board_whatever_lens_it_has(capsys, tmp_path, model, lens):
    matrix, noise = np.array([[1050.0, 0, 644.0], [0, 1049.0, 357.0], [0, 0, 1]]), np.random.default_rng(3)
    board_mm = np.array([(x, y, 0.0) for y in range(6) for x in range(9)]) * 30.0
    project = cv2.fisheye.projectPoints if model == "equidistant" else cv2.projectPoints
    for number in range(8):
        turn = np.array([0.4 * np.sin(number), 0.4 * np.cos(number), 0.05 * number])
        shift = np.array([50.0 * np.cos(2 * number) - 120, 25.0 * np.sin(2 * number) - 75, 560.0])
        seen = project(board_mm[:, None], turn, shift, matrix, np.array(lens))[0].reshape(-1, 2)
        rows = np.column_stack([seen + 0.5 + noise.normal(0, 0.02, seen.shape), board_mm[:, :2], range(54)])
        np.savetxt(tmp_path / f"board{number}.csv", rows, fmt=["%.6f"] * 4 + ["%d"])
    stated = tmp_path / "camera_info.yaml"
    stated.write_text(
        f"image_width: 1280\nimage_height: 720\ncamera_matrix: {{data: {matrix.ravel().tolist()}}}\n"
        f"distortion_model: {model}\ndistortion_coefficients: {{data: {lens}}}\n"
    )
    points = sorted(tmp_path.glob("*.csv"))
    words = ["check", *points, "--image-size", "1280x720", "--board", "checkerboard:9x6:30mm"]
    assert out_of(capsys, *words, "--calibration", stated).startswith("RIGHT")

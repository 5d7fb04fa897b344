"""`calibrate --board` and `--reconstruct`: boards become a planar calibration with a report."""

import json
import re

import cv2
import numpy as np
import pytest
from board_photographs import photograph
from calling import call

from bench.measure.moving_recording import MovingRecording
from bench.solve import loose_recordings
from calib.model.camera import CameraModel
from calib.model.rotation import exp_map
from drivers.camera.formats.event_conversion import convert
from tests.support.printed_text import printed_text

# ---------------------------------------------------------------- photographs of a checkerboard

SIZE = (400, 300)

TRUE = {"fx": 560.0, "fy": 561.5, "cx": 198.0, "cy": 152.0, "k1": -0.1}

CAMERA = CameraModel(560.0, 561.5, 198.0, 152.0, SIZE, {"k1": -0.1, "k2": 0.05})

PLACES = [
    ((0, 0, 5), 0.0),
    ((30, 5, 0), 10.0),
    ((-28, 10, 20), -10.0),
    ((5, 32, 50), 5.0),
    ((8, -30, 80), 0.0),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("boards")
    for number, (turn, shift) in enumerate(PLACES):
        seen = photograph(CAMERA, (7, 5), turn, (shift, -shift / 2, 300.0), dark=20.0, bright=200.0)
        noisy = seen + np.random.default_rng(number).normal(0, 2, seen.shape)
        cv2.imwrite(str(folder / f"placement{number}.png"), np.uint8(np.clip(noisy, 0, 255)))
    cv2.imwrite(str(folder / "nothing.png"), np.full(SIZE[::-1], 90, np.uint8))
    return folder


def test_photographs_of_a_checkerboard_give_the_camera_within_its_uncertainty(folder, tmp_path, capsys):
    out = tmp_path / "out"
    captured = call(capsys, "calibrate", folder, "--board", "checkerboard:7x5:20mm", "-o", out, "--json")
    answer = json.loads(captured.out)
    assert answer["model"] == "planar"
    k = answer["coverage_factor"]
    for name, true in TRUE.items():
        assert abs(answer["camera"][name] - true) <= k * answer["sigma"][name]
    assert answer["sigma"]["fx"] < 0.5
    (left_out,) = answer["skipped"]
    assert "nothing" in left_out
    assert "7 x 5 inner corners" in left_out
    report = (out / "report.html").read_text()
    words = " ".join([*re.findall(r'aria-label="([^"]*)"', report), *printed_text(report)])
    assert not re.search(r"(?i)(?<![\w-])(stars?|wavefront|gimbal readings)\b", words)
    assert "the board\N{RIGHT SINGLE QUOTATION MARK}s nominal dimensions" in words
    results = json.loads((out / "results.json").read_text())
    assert results["run"]["board"] == "checkerboard:7x5:20mm"
    pattern = json.loads((out / "exports" / "metavision.json").read_text())["pattern"]
    assert (pattern["n_cols"], pattern["n_rows"]) == (7, 5)


def test_files_of_others_in_a_folder_are_named_and_change_nothing(folder, tmp_path, capsys):
    words = ("--board", "checkerboard:7x5:20mm", "--json")
    alone = json.loads(call(capsys, "calibrate", folder, *words).out)
    for file in folder.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    strangers = {
        "README.txt": b"Pictures of the board, taken in the lab.\n",
        "timestamps.txt": b"1403636579763555584\n1403636579813555456\n",
        "data.csv": b"#timestamp [ns],filename\n1403636579763555584,placement0.png\n",
        "damaged.png": b"\x89PNG\r\n\x1a\n",
        "noise.raw": bytes(range(256)),
        "._placement0.png": b"\x00\x05\x16\x07\x00\x02\x00\x00",
        ".DS_Store": b"\x00\x00\x00\x01Bud1",
        "Thumbs.db": b"\xd0\xcf\x11\xe0",
    }
    for name, content in strangers.items():
        (tmp_path / name).write_bytes(content)
    answer = json.loads(call(capsys, "calibrate", tmp_path, *words).out)
    assert answer["camera"] == alone["camera"]
    left_out = " ".join(answer["skipped"])
    assert all(name in left_out for name in strangers)


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        (["--model", "joint"], "no collimator before it"),
        (["--passport", "some.json"], "no collimator before it"),
        (["--board", "chequers"], "does not describe a board"),
    ],
)
def test_options_that_contradict_a_board_are_refused(folder, capsys, more, reason):
    captured = call(capsys, "calibrate", folder, "--board", "checkerboard:7x5:20mm", *more, status=2)
    assert reason in captured.err


# ---------------------------------------------------------------- a recording of a moving camera

PATTERN = "checkerboard:5x4:10mm"

SQUARE_PX, PITCH_MM, FOCAL_PX = 24.0, 10.0, 300.0

WAY_PX, SPEED_PX_S = 60.0, 1000.0

SENSOR = (240, 200)


def picture_at(shift_px, roll_deg):
    """Log brightness of a tilted board of 5 x 4 inner corners, shifted along the diagonal."""
    v, u = np.mgrid[: SENSOR[1], : SENSOR[0]]
    rays = np.stack(
        [(u - SENSOR[0] / 2) / FOCAL_PX, (v - SENSOR[1] / 2) / FOCAL_PX, np.ones(u.shape)], axis=-1
    )
    around = np.radians(5.0 * roll_deg)
    tilt = exp_map(0.6 * np.array([np.cos(around), np.sin(around), 0.0]))
    rotation = tilt @ exp_map(np.array([0.0, 0.0, np.radians(roll_deg)]))
    place = np.array([0.8 * shift_px, 0.6 * shift_px, FOCAL_PX]) * PITCH_MM / SQUARE_PX
    normal = rotation[:, 2]
    points = rays * ((normal @ place) / (rays @ normal))[..., None] - place
    a, b = (points @ rotation[:, axis] / PITCH_MM for axis in (0, 1))
    soft = np.tanh(6 * np.sin(np.pi * a)) * np.tanh(6 * np.sin(np.pi * (b + 0.5)))
    inside = (np.abs(a) < 3) & (np.abs(b) < 2.5)
    return np.where(inside, soft, -1.0)


def events(turns_deg):
    """Events of an ideal pixel with a threshold of 0.3, for boards that pass one after the other."""
    pieces, level = [], picture_at(-WAY_PX / 2, turns_deg[0])
    steps = int(WAY_PX)
    for number, turn in enumerate(turns_deg):
        for step in range(steps):
            now = picture_at(step - WAY_PX / 2, turn)
            crossed = np.trunc((now - level) / 0.3).astype(int)
            rows, columns = np.nonzero(crossed)
            count = np.abs(crossed[rows, columns])
            level[rows, columns] += 0.3 * crossed[rows, columns]
            t_us = int(1e6 * (number * steps + step) / SPEED_PX_S)
            where = np.repeat(np.arange(len(rows)), count)
            times = np.sort(t_us + (np.arange(len(where)) * 997) % 900)
            pieces.append((times, columns[where], rows[where], crossed[rows, columns][where] > 0))
    return [np.concatenate(each) for each in zip(*pieces, strict=True)]


@pytest.fixture(scope="module")
def moving_folder(tmp_path_factory):
    moving_folder = tmp_path_factory.mktemp("moving")
    t, x, y, p = events([10, 35, -20, 60])
    pixels = {
        "x": x.astype(np.uint16),
        "y": y.astype(np.uint16),
        "p": p.astype(np.uint8),
        "size": np.array(SENSOR),
    }
    triggers = {"trigger_t": np.zeros(0, np.int64)} | {
        f"trigger_{name}": np.zeros(0, np.uint8) for name in ("value", "id")
    }
    np.savez(moving_folder / "events.npz", t=t, **pixels, **triggers)
    convert(moving_folder / "events.npz", moving_folder / "moving.raw", "raw")
    return moving_folder


def test_pictures_of_a_moving_camera_become_views(moving_folder, capsys, monkeypatch):
    monkeypatch.setattr(loose_recordings, "MOST_EVENTS", 1000)  # of recordings that are no pictures
    words = ("--board", PATTERN, "--json", "--reconstruct")
    captured = call(capsys, "calibrate", moving_folder / "moving.raw", *words)
    answer = json.loads(captured.out)
    names = [view["name"] for view in answer["views"]]
    assert set(names) <= {f"moving-at-0.{ms}s" for ms in ("030", "090", "149", "150", "209", "210")}
    assert len(names) >= 3
    assert "Of long recordings" not in captured.out
    assert abs(answer["camera"]["fx"] - FOCAL_PX) < 2.0 * answer["sigma"]["fx"] + 3.0


def test_pictures_do_not_depend_on_the_order_in_which_they_are_asked_for(moving_folder):
    moving = MovingRecording(moving_folder / "moving.raw", 10.0)
    later, earlier = moving.picture(1), moving.picture(0)
    np.testing.assert_array_equal(moving.picture(1).image, later.image)
    assert earlier.at_us < later.at_us
    assert len(moving.at_s) == 4


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--reconstruct"], "for boards only"),
        (["--board", PATTERN, "--reconstruct", "moving.raw"], "after the paths"),
        (["--board", PATTERN, "--reconstruct", "nan"], "not a frequency"),
    ],
)
def test_what_does_not_fit_is_refused(moving_folder, capsys, words, message):
    assert message in call(capsys, "calibrate", moving_folder / "moving.raw", *words, status=2).err


def test_the_events_of_another_program_are_converted_first(moving_folder, capsys):
    events = moving_folder / "events.npz"
    refusal = call(capsys, "calibrate", events, "--board", PATTERN, "--reconstruct", status=2)
    assert f"starbench convert {events} " in refusal.err


def test_a_board_that_moves_along_its_edges_or_too_little_is_named_with_what_to_do(moving_folder, capsys):
    words = ("--board", "checkerboard:9x6:10mm", "--reconstruct")
    captured = call(capsys, "calibrate", moving_folder / "moving.raw", *words, status=1)
    assert "Move the camera obliquely" in captured.err

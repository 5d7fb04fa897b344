"""`calibrate --reconstruct`: a RAW recording of a moving camera becomes pictures at stated times and a calibration."""

import json

import numpy as np
import pytest

from bench.commands.cli import main
from bench.views.measure_board import MovingRecording
from calib.model.rotation import exp_map

BOARD = "checkerboard:5x4:10mm"
SQUARE_PX, PITCH_MM, FOCAL_PX = 24.0, 10.0, 300.0
WAY_PX, SPEED_PX_S = 60.0, 1000.0
SIZE = (240, 200)


def picture_at(shift_px, roll_deg):
    """Log brightness of a tilted board of 5 x 4 inner corners, shifted along the diagonal."""
    v, u = np.mgrid[: SIZE[1], : SIZE[0]]
    rays = np.stack([(u - SIZE[0] / 2) / FOCAL_PX, (v - SIZE[1] / 2) / FOCAL_PX, np.ones(u.shape)], axis=-1)
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
    found, level = [], picture_at(-WAY_PX / 2, turns_deg[0])
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
            found.append((times, columns[where], rows[where], crossed[rows, columns][where] > 0))
    return [np.concatenate(each) for each in zip(*found, strict=True)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("moving")
    t, x, y, p = events([10, 35, -20, 60])
    np.savez(
        folder / "events.npz",
        t=t,
        x=x.astype(np.uint16),
        y=y.astype(np.uint16),
        p=p.astype(np.uint8),
        size=np.array(SIZE),
        trigger_t=np.zeros(0, np.int64),
        trigger_value=np.zeros(0, np.uint8),
        trigger_id=np.zeros(0, np.uint8),
    )
    with pytest.raises(SystemExit) as end:
        main(["convert", str(folder / "events.npz"), str(folder / "moving.raw")])
    assert end.value.code == 0
    return folder


def say(capsys, *words, status):
    with pytest.raises(SystemExit) as end:
        main(["calibrate", *(str(word) for word in words)])
    said = capsys.readouterr()
    assert end.value.code == status, said.err
    return said


def test_pictures_at_stated_times_become_views(folder, capsys):
    said = say(
        capsys,
        folder / "moving.raw",
        "--board",
        BOARD,
        "--json",
        "--pictures-at",
        "0.03,0.09,0.15,0.21",
        "--reconstruct",
        status=0,
    )
    found = json.loads(said.out)
    names = [view["name"] for view in found["views"]]
    assert set(names) <= {f"moving-at-0.{ms}s" for ms in ("030", "090", "150", "210")}
    assert len(names) >= 3
    assert abs(found["camera"]["fx"] - FOCAL_PX) < 2.0 * found["sigma"]["fx"] + 3.0


def test_pictures_do_not_depend_on_the_order_in_which_they_are_asked_for(folder):
    moving = MovingRecording(folder / "moving.raw", 10.0, (0.03, 0.09))
    later, earlier = moving.picture(1), moving.picture(0)
    np.testing.assert_array_equal(moving.picture(1).image, later.image)
    assert earlier.at_us < later.at_us
    assert len(MovingRecording(folder / "moving.raw", 10.0).at_s) == 2


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--reconstruct"], "for boards only"),
        (["--board", BOARD, "--pictures-at", "0.1"], "Add --reconstruct"),
        (["--board", BOARD, "--reconstruct", "--pictures-at", "0.2,0.1"], "do not ascend"),
        (["--board", BOARD, "--reconstruct", "--pictures-at", "soon"], "not a list of times"),
        (["--board", BOARD, "--reconstruct", "--pictures-at", "9"], "s long"),
        (["--board", BOARD, "--reconstruct", "moving.raw"], "after the paths"),
        (["--board", BOARD, "--reconstruct", "nan"], "not a frequency"),
    ],
)
def test_what_does_not_fit_is_refused(folder, capsys, words, said):
    assert said in say(capsys, folder / "moving.raw", *words, status=2).err


def test_the_events_of_another_program_are_converted_first(folder, capsys):
    said = say(capsys, folder / "events.npz", "--board", BOARD, "--reconstruct", status=2)
    assert "starbench convert events.npz" in said.err


def test_a_board_that_moves_along_its_edges_or_too_little_is_named_with_what_to_do(folder, capsys):
    said = say(capsys, folder / "moving.raw", "--board", "checkerboard:9x6:10mm", "--reconstruct", status=1)
    assert "Move the camera obliquely" in said.err


@pytest.mark.slow
def test_a_simulated_moving_board_is_reconstructed_where_it_stands_at_the_time_of_the_picture():
    from bench.compare.scenes import record_moving
    from bench.compare.spec import ComparisonConfig
    from bench.simulated import virtual_camera
    from calib.boards.board import Board
    from calib.boards.detect import detect_board

    column = ComparisonConfig(
        format="starbench/comparison/1",
        name="x",
        columns=[{"name": "a", "method": "reconstruction", "images": 2, "board": {"focus": "sharp"}}],
    ).columns[0]
    screen = {
        "columns": 11,
        "rows": 7,
        "square_mm": 12.0,
        "position_mm": [0.0, 0.0, 900.0],
        "turn_deg": [20, -15, 12],
    }
    section = {"noise": "typical", "screen": screen}
    section["optics"] = {"mounting_deg": [0.0, 0.0, 0.0]}
    picture = record_moving(column, section, 3345.0, 3, 1)[True]
    view = detect_board(picture, Board("checkerboard", 11, 7, 12.0))
    true = virtual_camera(section, 3).board_corners_px()[view.ids]
    if np.linalg.norm(view.points_px[0] - true[0]) > 50:
        true = true[::-1]
    apart = view.points_px - true
    assert np.linalg.norm(apart.mean(axis=0)) < 0.3  # the latency of the pixels moves all points alike
    assert np.sqrt(np.mean((apart - apart.mean(axis=0)) ** 2)) < 0.05

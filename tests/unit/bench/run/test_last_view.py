"""The picture of the last recording that a run leaves for people who watch."""

import os

import numpy as np
import pytest

from bench.run.control import inbox_of
from bench.run.heartbeat import CONTROL, LAST_VIEW, leave_view, read_last_view
from bench.views.measure import Measurement, StoredImage
from calib.target import StarTarget
from calib.view import View


def _measurement(fault=""):
    image = np.arange(40 * 30, dtype=np.float32).reshape(30, 40)
    ids = np.array([3, 4, 9])
    target = StarTarget()
    points_px = np.array([[1.23456, 2.0], [3.0, 4.0], [5.0, 6.0]])
    view = View("left", (40, 30), ids, points_px, target.positions_mm(ids), np.tile(np.eye(2), (3, 1, 1)))
    return Measurement(None if fault else view, StoredImage.from_image(image), {}, fault)


def test_a_picture_is_left_and_read_again(tmp_path):
    (tmp_path / CONTROL).mkdir()
    found = _measurement()
    leave_view(tmp_path, 2, 1, found, StarTarget())
    left = read_last_view(tmp_path)
    assert (left.pose, left.attempt) == (2, 1)
    assert left.nodes == StarTarget().node_of([3, 4, 9]).tolist()
    assert left.points_px[0] == [1.235, 2.0]
    assert left.png == found.image.png
    leave_view(tmp_path, 2, 2, _measurement("no stars"), StarTarget())
    left = read_last_view(tmp_path)
    assert (left.attempt, left.nodes, left.fault) == (2, [], "no stars")


def test_it_is_no_command_and_stays_in_the_inbox(tmp_path):
    (tmp_path / CONTROL).mkdir()
    leave_view(tmp_path, 1, 1, _measurement(), StarTarget())
    inbox_of(tmp_path).drain(lambda *_: pytest.fail("the picture was taken for a command"))
    assert (tmp_path / CONTROL / LAST_VIEW).exists()


def test_without_an_inbox_or_an_image_nothing_is_left(tmp_path):
    leave_view(tmp_path, 1, 1, _measurement(), StarTarget())
    (tmp_path / CONTROL).mkdir()
    leave_view(tmp_path, 1, 1, Measurement(None, None), StarTarget())
    assert read_last_view(tmp_path) is None
    assert not list((tmp_path / CONTROL).iterdir())


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="the administrator may write anywhere")
def test_a_folder_that_cannot_be_written_does_not_disturb_the_run(tmp_path):
    (tmp_path / CONTROL).mkdir(mode=0o500)
    leave_view(tmp_path, 1, 1, _measurement(), StarTarget())
    assert read_last_view(tmp_path) is None


def test_a_full_disk_does_not_disturb_the_run(tmp_path, monkeypatch):
    (tmp_path / CONTROL).mkdir()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    leave_view(tmp_path, 1, 1, _measurement(), StarTarget())
    assert read_last_view(tmp_path) is None


@pytest.mark.parametrize("text", [b"", b"{}\n", b"[1]\n", b'{"pose": 1', b"\xff\xfe\n"])
def test_a_damaged_file_is_no_picture(tmp_path, text):
    (tmp_path / CONTROL).mkdir()
    (tmp_path / CONTROL / LAST_VIEW).write_bytes(text)
    assert read_last_view(tmp_path) is None

"""Two simulated event cameras behind one collimator, from their RAW recordings: rotation, and the offset of the clocks."""

import json
import re

import cv2
import numpy as np
import pytest
from calling import out_of, refusal
from virtual_camera import QUARTER, VirtualCamera

from calib.model.rotation import log_map
from simulators.config import bench_config
from simulators.optics.picture import true_rotation
from simulators.pixels.evt3_writer import Evt3Writer

MOUNTS = {"left": {}, "right": {"turn_deg": [0.4, -0.6, 3.0]}}
SECTIONS = {name: {"camera": QUARTER, "mount": mount, "noise": "clean"} for name, mount in MOUNTS.items()}
SEED = 3
POSES = [{"pan": -5, "tilt": 2}, {"pan": 5, "tilt": 2}, {"pan": 0, "tilt": -3}]
LIGHT_HZ, PERIODS = 240.0, 8
OFFSET_US, GAIN = -812.0, 80e-6


def record(camera, pose, number, path, clock):
    """Write what the camera sends in a pose, by its own clock: events, and an edge at each change of the light."""
    capture = camera.capture(pose, seed=number, light_hz=LIGHT_HZ, periods=PERIODS)
    period = 1e6 / LIGHT_HZ
    # Both cameras see one light: the first edge of each recording stands at the same time.
    times = 5000.0 + period / 2.0 * np.arange(2 * PERIODS)
    edges = np.round(clock(times)).astype(np.int64)
    t = np.round(clock(capture.events.t - capture.first_edge_us + 5000.0)).astype(np.int64)
    first = int(min(t.min(), edges.min())) // 16 * 16 - 160
    order = np.argsort(t, kind="stable")
    writer = Evt3Writer(first, width=QUARTER["width"], height=QUARTER["height"])
    words = writer.write(
        t[order], *(np.asarray(values)[order] for values in capture.events[1:]), until_us=int(t.max()) + 2000,
        trigger_t=edges, trigger_value=(np.arange(len(edges)) % 2 == 0).astype(np.uint8),
    )  # fmt: skip
    path.write_bytes(b"% format EVT3;height=360;width=640\n% end\n" + words.tobytes())


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Recordings of both cameras."""
    folder = tmp_path_factory.mktemp("recordings")
    middle = 5000.0 + 1e6 / LIGHT_HZ * PERIODS / 2.0
    clocks = {
        "left": lambda t: t + 1e6,
        "right": lambda t: t + 1e6 + OFFSET_US + GAIN * (t - middle),
    }
    for name, clock in clocks.items():
        camera = VirtualCamera(SECTIONS[name], SEED)
        (folder / name).mkdir()
        for number, pose in enumerate(POSES, 1):
            record(camera, pose, number, folder / name / f"pose-{number}.raw", clock)
    return folder


def test_rotation_and_clocks_are_those_of_the_simulated_rig(capsys, folder):
    words = ("rig", folder / "left", folder / "right", "--sync")
    answer = json.loads(out_of(capsys, *words, "--json"))
    truths = (bench_config(SECTIONS[name]).truth_for(SEED) for name in ("left", "right"))
    left, right = (true_rotation(POSES[0], truth) for truth in truths)
    off = 206265 * log_map(np.array(answer["rotation"]) @ (right @ left.T).T)
    assert (np.abs(off) < 4.0 * np.array(answer["sigma_arcsec"])).all(), (off, answer["sigma_arcsec"])
    assert answer["rigid"]
    assert len(answer["clocks"]["recordings"]) == len(POSES)
    for clock in answer["clocks"]["recordings"]:
        assert clock["offset_us"] == pytest.approx(OFFSET_US, abs=3.0 * clock["sigma_us"])
        assert clock["period_us"] == pytest.approx(1e6 / LIGHT_HZ, abs=1.0)
        assert clock["edges"] == PERIODS
    assert answer["clocks"]["rate_ppm"] == pytest.approx(80.0, abs=3.0 * answer["clocks"]["sigma_rate_ppm"])


def test_the_offset_is_shown_where_it_was_asked_for(capsys, folder):
    words = ("rig", folder / "left", folder / "right")
    shown = out_of(capsys, *words, "--sync")
    assert re.search(r"second - first = .81[12]", shown)
    assert "whole periods" in shown
    assert "Clock of" not in out_of(capsys, *words)


def test_the_clocks_of_pictures_are_not_asked_for(capsys, folder, tmp_path):
    (tmp_path / "pictures").mkdir()
    cv2.imwrite(str(tmp_path / "pictures" / "pose-1.png"), np.zeros((300, 400), np.uint8))
    words = ("rig", folder / "left", tmp_path / "pictures", "--sync", "-o", tmp_path / "new")
    assert "RAW recordings only" in refusal(capsys, *words, status=2)
    assert not (tmp_path / "new").exists()

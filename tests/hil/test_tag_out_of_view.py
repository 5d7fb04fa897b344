"""Poses in which the tag is out of view: named by the gimbal and earlier poses, or refused; and told in the result."""

import json

import cv2
import numpy as np
import pytest
from running import journal, results, starbench

from bench.measure.measure_frames import measure_frames
from calib.errors import DegenerateViews
from calib.model.homography import apply_homography, fit_homography
from simulators.optics.picture import TARGET, pose_rotation, render, star_centres
from simulators.world.truth import Truth

SEQUENCE = """\
format: starbench/sequence/1
name: The tag out of view
poses:
  some:
{poses}
steps:
  - light
  - repeat: {{poses: some, steps: [move, settle, record]}}
  - light: off
  - solve
  - report
"""
WITH_TAG = [(-6, 2), (6, 2), (0, -3)]
WITHOUT = [(0, 8), (13.8, -2)]


def no_pose(_size):
    raise DegenerateViews("No earlier view")


def test_photographs_without_the_tag_are_named_the_same_way(tmp_path):
    truth = Truth()
    rotation = pose_rotation({"tilt": 8.0, "roll": 9.0}, truth.optics)
    cv2.imwrite(str(tmp_path / "p.png"), np.uint8(20 + 200 * render(truth, rotation)))
    ids, points = star_centres(truth, rotation)
    grid = fit_homography(TARGET.node_of(ids).astype(float), points)
    named = measure_frames(tmp_path / "p.png", name="p", target=TARGET, expected_grid=lambda _size: grid)
    assert named.facts["named_by"] == "gimbal"
    assert np.abs(apply_homography(np.array(named.facts["grid"]), TARGET.node_of(ids)) - points).max() < 5
    unnamed = measure_frames(tmp_path / "p.png", name="p", target=TARGET, expected_grid=no_pose)
    assert unnamed.view is None
    assert unnamed.fault.endswith("more of the tag is in view. No earlier view")


def run(folder, home, poses, status=0):
    lines = "\n".join(f"    - {{pan_deg: {pan}, tilt_deg: {tilt}}}" for pan, tilt in poses)
    sequence = folder / "poses.yaml"
    sequence.write_text(SEQUENCE.format(poses=lines))
    words = ("run", sequence, "-s", "simulated_ideal", "--seed", 5, "-o", folder / "run", "--json")
    return starbench(*words, home=home, status=status), folder / "run"


@pytest.fixture(scope="module")
def finished(tmp_path_factory, home):
    ended, folder = run(tmp_path_factory.mktemp("named"), home, [*WITH_TAG, *WITHOUT])
    return json.loads(ended.stdout), folder


@pytest.mark.slow
def test_poses_without_the_tag_calibrate_and_the_result_says_what_named_their_stars(finished):
    answer, folder = finished
    poses = results(folder)["poses"]
    assert [pose["named_by"] for pose in poses] == ["tag"] * 3 + ["gimbal"] * 2
    assert min(pose["stars"] for pose in poses) > 60
    assert max(pose["rms_px"] for pose in poses) < 0.1
    assert max(abs(row["error_sigmas"]) for row in answer["results"]["comparison"]) < 4
    assert "identified by the gimbal" in (folder / "report.html").read_text()


@pytest.mark.slow
def test_motion_is_judged_in_poses_without_the_tag_too(finished):
    _, folder = finished
    checked = [line["measured"] for line in journal(folder) if line["event"] == "attempt_checked"]
    assert len(checked) == 5
    assert all(measured["motion_px"] < 0.05 for measured in checked)


@pytest.mark.slow
def test_without_earlier_poses_that_show_the_tag_the_stars_stay_unnamed(tmp_path, home):
    ended, folder = run(tmp_path, home, [WITHOUT[0], *WITH_TAG], status=1)
    assert "no readable part" in ended.stderr
    assert "the tag in view" in ended.stderr
    assert not any(line["accepted"] for line in journal(folder) if line["event"] == "attempt_checked")

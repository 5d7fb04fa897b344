"""The parallax in results.json and in the report: the place of the pupil, what to write, or why there is no result."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

import bench.solve.checks as checked
from bench.plan.plan import load_documents, make_plan
from bench.report.run_tables import parallax_rows
from bench.solve.checks import mount_faces, parallax_check
from bench.stations.station import GimbalConfig
from calib.errors import DegenerateViews
from calib.model.collimator import Collimator
from calib.model.result_parts import Boresight
from calib.studies.parallax import PupilWalk

COLLIMATOR = Collimator(97.0, 140.0, 255.0)
REFUSED = DegenerateViews("1 of 9 views show the rim.", where="parallax test", remedy="Turn farther.")


def station(off="{value: 2, sigma: 0.5}", defocus="{value: 0.066, sigma: 0.01}"):
    gimbal = "{reading_sigma_deg: 0.002, source: G-3" + (f", pupil_off_pivot_mm: {off}}}" if off else "}")
    settings = {"station.gimbal": gimbal, "station.collimator.defocus": defocus}
    planned = make_plan(*load_documents("parallax_test", "simulated", settings))
    assert planned.faults == ()
    return planned.station.value


def calibration(collimator=COLLIMATOR):
    camera = SimpleNamespace(fx=3345.0)
    return SimpleNamespace(collimator=collimator, rotations=np.eye(3)[None], camera=camera)


@pytest.fixture
def find_pupil(monkeypatch):
    """Let the study find a pupil."""

    def find(off, sigma, error=None, without=()):
        walk = PupilWalk(np.array([-off, -off]), np.eye(2) * 2 * sigma**2, off, sigma, 9, without)

        def study(*_arguments):
            if error:
                raise error
            return walk

        monkeypatch.setattr(checked, "pupil_walk", study)

    return find


def test_a_pupil_that_the_station_does_not_state_is_to_be_written_into_it(find_pupil):
    find_pupil(44.0, 2.0)
    check = parallax_check(calibration(), [], station(off=""), "Nine poses")
    assert check["pupil_off_pivot_mm"] == {"value": 44.0, "sigma": 2.0}
    assert check["stated_mm"] is None
    assert check["parallax"]["value"] == pytest.approx(-0.066 * 44 / 255)
    assert check["fx_px"]["value"] == pytest.approx(38.1, abs=0.1)
    assert check["defocus"]["source"] == "station"
    entry = yaml.safe_load(check["station_entry"])["gimbal"]
    stated = GimbalConfig.model_validate({"reading_sigma_deg": 0.002, "source": "this test", **entry})
    assert (stated.pupil_off_pivot_mm.value, stated.pupil_off_pivot_mm.sigma) == (44.0, 2.0)
    assert any(sentence.endswith(check["station_entry"]) for sentence in check["says"])
    assert json.loads(json.dumps(check, allow_nan=False)) == check


@pytest.mark.parametrize(
    ("off", "sigma", "word", "advised"),
    [(44.0, 2.0, "contradicts", True), (3.0, 1.0, "agrees with", False), (2.1, 0.2, "agrees with", True)],
)
def test_the_pupil_is_compared_with_the_station(find_pupil, off, sigma, word, advised):
    find_pupil(off, sigma)
    check = parallax_check(calibration(), [], station(), "Parallax test")
    says = " ".join(check["says"])
    assert re.search(f"{word} .* 2 mm", says)
    assert (check["station_entry"] in says) == advised
    assert ("keep it" in says) != advised


def test_a_pupil_that_contradicts_along_one_axis_only_is_noticed(monkeypatch):
    walk = PupilWalk(np.array([-39.2, -2.0]), np.diag([32.0, 76.0]), 20.6, 19.0, 15, ())
    monkeypatch.setattr(checked, "pupil_walk", lambda *_arguments: walk)
    check = parallax_check(calibration(), [], station(), "Parallax test")
    assert "contradicts the station file" in " ".join(check["says"])


def test_without_a_stated_defocus_there_is_no_parallax(find_pupil):
    find_pupil(2.0, 1.0)
    bare = parallax_check(calibration(), [], station(defocus=""), "Parallax test")
    assert (bare["defocus"], bare["parallax"], bare["fx_px"]) == (None, None, None)
    assert "does not state" in bare["says"][-1]


def test_only_the_parallax_test_says_why_there_is_no_result(find_pupil):
    find_pupil(0.0, 1.0, REFUSED)
    assert parallax_check(calibration(), [], station(), "Nine poses") is None
    check = parallax_check(calibration(), [], station(), "Parallax test")
    assert "1 of 9 views" in check["why_not"]
    assert parallax_rows(check) == [("Parallax test: no result", check["why_not"])]
    planar = parallax_check(calibration(collimator=None), [], station(), "Parallax test")
    assert planar["why_not"].startswith("The planar model")


def test_the_report_states_the_place_of_the_pupil_and_the_poses_without_rim(find_pupil):
    find_pupil(2.7, 1.0, without=("left", "right"))
    rows = dict(parallax_rows(parallax_check(calibration(), [], station(), "Parallax test")))
    assert rows["Entrance pupil in front of the pivot"] == "2.7 ± 2.0 mm (k = 2)"
    assert "-2.7 ± 1.4 mm along x" in next(row for name, row in rows.items() if name.startswith("Parallax"))
    assert rows["Poses with the rim out of view"] == "left, right"
    assert parallax_rows(None) == []


def test_faces_of_the_mount_get_their_angle_to_the_ray_through_the_middle():
    boresight = Boresight(
        np.eye(3), 1e-8 * np.eye(3), np.ones(3), np.array([0, 0, 1.0]), 1e-8 * np.eye(2), np.ones(2)
    )
    faces = "{front: {normal: [0, 0.1, 5]}, side: {normal: [-2, 0, 0], sigma_deg: 1}}"
    settings = {"station.gimbal": f"{{reading_sigma_deg: 0.002, source: G-3, faces: {faces}}}"}
    stated = make_plan(*load_documents("three_pose", "simulated", settings)).station.value
    front, side = mount_faces(SimpleNamespace(boresight=boresight), stated)
    assert (front.name, side.name) == ("front", "side")
    assert front.angle_deg == pytest.approx(np.degrees(np.arctan(0.02)))
    assert (side.angle_deg, side.normal_in_camera) == (pytest.approx(90.0), [-1.0, 0.0, 0.0])
    assert side.expanded_deg > 50 * front.expanded_deg > 0
    assert mount_faces(SimpleNamespace(boresight=None), stated) is None
    assert mount_faces(SimpleNamespace(boresight=boresight), station()) is None

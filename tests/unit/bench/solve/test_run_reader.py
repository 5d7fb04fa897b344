"""A solved run is read as it was written, and a notebook can calibrate again from it."""

import json
import shutil

import numpy as np
import pytest
from rehearsed import Scene
from solved_run import image_of, write_solved_run

from bench.base.bounded_json import canonical_json
from bench.base.errors import RunFolderError, StorageError
from bench.record.stored_run import StoredRun
from bench.solve.run_reader import load
from calib import CalibrationOptions, calibrate


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_solved_run(tmp_path_factory.mktemp("solved"))


@pytest.fixture
def copied(folder, tmp_path):
    """The run, for a test to damage."""
    return shutil.copytree(folder, tmp_path / "copy")


def edit(folder, change):
    path = folder / "results.json"
    results = json.loads(path.read_bytes())
    change(results)
    path.write_text(json.dumps(results))


def test_camera_collimator_and_covariance_are_those_of_the_results(folder):
    run, stored = load(folder), json.loads((folder / "results.json").read_bytes())["calibration"]
    assert run.camera.to_dict() == stored["camera"]
    assert run.camera.image_size == tuple(stored["image_size"]) == (640, 360)
    assert run.collimator.to_dict() == stored["collimator"]
    assert run.parameter_names == tuple(stored["covariance"]["names"])
    assert run.covariance.tolist() == stored["covariance"]["matrix"]
    assert run.sigma == pytest.approx(stored["sigma"], rel=1e-14)
    assert run.camera_covariance.tolist() == [row[:5] for row in stored["covariance"]["matrix"][:5]]
    assert json.loads(canonical_json(run.results["calibration"])) == stored
    assert run.report == folder / "report.html"


def test_calibrating_again_with_the_same_options_gives_the_same_bits(folder):
    run = load(str(folder))
    again = calibrate(run.views, CalibrationOptions("spherical", distortion="k1"))
    stored = json.loads(canonical_json(run.results["calibration"]))
    assert again.to_dict() == {**stored, "notes": list(again.notes)}
    for residuals, pose, rotation, centre in zip(
        again.residuals_px, run.poses, again.rotations, again.centres, strict=True
    ):
        assert np.array_equal(residuals, pose.residuals_px)
        assert np.array_equal(rotation, pose.rotation)
        assert np.array_equal(centre, pose.centre_mm)
        target = np.column_stack([pose.view.target_mm, np.zeros(len(pose.view))])
        projected = run.camera.project((target - centre) @ rotation.T)
        assert residuals == pytest.approx(pose.view.points_px - projected, abs=1e-9)


def test_poses_have_names_angles_and_pictures(folder):
    run = load(folder)
    names = ["left", "right", "above", "below"]
    assert [(pose.index, pose.name) for pose in run.poses] == list(enumerate(names, 1))
    assert [view.name for view in run.views] == [pose.name for pose in run.poses]
    assert run.poses[0].commanded_deg == {"pan": -5, "tilt": 0}
    assert run.poses[0].measured_deg["pan"] == pytest.approx(-5, abs=0.01)
    for pose, residuals in zip(run.poses, run.residuals_px, strict=True):
        assert pose.rotation @ pose.rotation.T == pytest.approx(np.eye(3), abs=1e-12)
        assert residuals is pose.residuals_px
        u, v = np.rint(pose.view.points_px[0]).astype(int)
        assert pose.picture.shape == image_of(pose.view).shape
        assert pose.picture[v, u] == pose.picture.max() > np.median(pose.picture)


def test_no_array_of_a_run_can_be_changed(folder):
    run = load(folder)
    own = [(p.rotation, p.centre_mm, p.residuals_px, p.view.points_px) for p in run.poses]
    for array in (run.covariance, run.calibration.estimates, *(each for arrays in own for each in arrays)):
        with pytest.raises(ValueError, match="read-only"):
            np.divide(array, 100, out=array)


def test_pictures_are_read_after_a_change_of_the_working_folder(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(folder.parent)
    run = load(folder.name)
    monkeypatch.chdir(tmp_path)
    assert run.poses[0].picture.any()


def test_a_recording_that_is_not_there_is_told_as_an_error_of_the_program(copied, monkeypatch):
    monkeypatch.setattr(StoredRun, "is_rehearsal", False)
    (copied / "views.h5").unlink()
    capture = min((copied / "captures").iterdir())
    capture.unlink()
    with pytest.raises(StorageError, match="No such file") as refused:
        load(copied)
    assert str(capture) in str(refused.value)


def test_a_collimator_keeps_its_aberrations(copied):
    edit(copied, lambda results: results["calibration"]["collimator"].update(defocus=0.01))
    run = load(copied)
    assert run.collimator.aberrations == {"defocus": 0.01}
    assert run.collimator.to_dict() == run.results["calibration"]["collimator"]


def test_a_rehearsed_run_is_refused(tmp_path):
    scene = Scene(tmp_path, end="  - solve: {model: spherical, distortion: [k1]}\n  - report\n")
    assert scene.run().how == "finished"
    with pytest.raises(RunFolderError, match="was rehearsed"):
        load(scene.folder)


@pytest.mark.parametrize("part", ["poses", "calibration"])
def test_incomplete_results_are_refused(copied, part):
    edit(copied, lambda results: results.pop(part))
    with pytest.raises(RunFolderError, match=f"results are incomplete|{part} is missing") as refused:
        load(copied)
    assert str(copied / "results.json") in str(refused.value)


def test_views_of_another_run_are_refused(copied, tmp_path):
    other = write_solved_run(tmp_path, poses="[{name: a, pan_deg: -5}, {name: b, pan_deg: 5}]")
    shutil.copy(other / "views.h5", copied / "views.h5")
    with pytest.raises(RunFolderError, match="different poses"):
        load(copied)

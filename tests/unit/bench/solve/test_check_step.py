"""The step `check` of a sequence: the run compares its calibration with a stated one, and says PASS or FAIL."""

import json
from dataclasses import replace

import pytest
from solved_run import write_solved_run

from bench.base.errors import ScriptError
from bench.plan.job import Job
from bench.plan.plan import load_documents, make_plan
from bench.record.run_folder import CHECKED_COPY
from bench.record.stored_calibration import stored_camera
from bench.record.stored_run import StoredRun
from bench.report.run_tables import check_rows
from bench.solve.exports import camera_info
from bench.wording.conformity import conformity_headline, conformity_sentences

END = "  - check: {calibration: %s, model: spherical, distortion: [k1]}\n  - report\n"


def run_with(folder, stated):
    folder.mkdir()
    return write_solved_run(folder, end=END.replace("%s", str(stated)))


def results_of(run):
    return StoredRun(run).results


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    """A run that was solved, and a file with its camera."""
    folder = tmp_path_factory.mktemp("stated")
    run = write_solved_run(folder)
    camera = stored_camera(results_of(run)["calibration"])
    longer = replace(camera, fx=1.01 * camera.fx, fy=1.01 * camera.fy)
    (folder / "longer.yaml").write_bytes(camera_info(longer, "camera", longer.matrix))
    return run, folder / "longer.yaml"


def test_a_run_checks_the_calibration_of_an_earlier_run(solved, tmp_path):
    run = run_with(tmp_path / "a", solved[0])
    results = results_of(run)
    assert results["check"].right is True
    assert results["check"].stated["kind"] == "the result of a run"
    assert results["check"].stated["uncertainty"] is True
    assert results["conformity"].passed is True
    assert conformity_headline(results["conformity"]) == "PASS: the checked calibration is right."
    assert (run / CHECKED_COPY).read_bytes() == (solved[0] / "results.json").read_bytes()
    ((name, text),) = check_rows(results["check"])
    assert name == f"Check of the calibration {solved[0]}"
    assert text.startswith("RIGHT within U everywhere")


def test_a_lens_that_became_longer_fails_the_run_and_the_folder_holds_all_that_decides_it(solved, tmp_path):
    run = run_with(tmp_path / "b", solved[1])
    results = results_of(run)
    assert (results["check"].right, results["check"].cause) == (False, "scale")
    assert results["conformity"].passed is False
    assert conformity_headline(results["conformity"]).startswith("FAIL")
    assert "largest E_n" in " ".join(conformity_sentences(results["conformity"]))
    text = check_rows(results["check"])[0][1]
    assert "NOT RIGHT" in text
    assert text.endswith("states no uncertainty.")
    gate = next(gate for gate in results["gates"] if gate["name"] == "largest E_n of the check")
    assert (gate["verdict"], gate["value"] > 1.0) == ("fail", True)
    again = Job.from_run_folder(run)  # by the copy, wherever the file is by now
    assert again.plan.checked.in_use.to_dict() == results["check"].stated
    (run / CHECKED_COPY).unlink()
    faults = make_plan(again.plan.sequence, again.plan.station, passport_copy=run / "passport.json").faults
    assert any(f"no {CHECKED_COPY}" in str(fault) for fault in faults)


def planned(folder, *steps):
    head = "format: starbench/sequence/1\nname: Check\nsteps:"
    text = "\n  - ".join([head, "record", *steps, "report\n"])
    (folder / "sequence.yaml").write_text(text)
    made = make_plan(*load_documents(str(folder / "sequence.yaml"), "simulated"))
    return [str(fault) for fault in made.faults]


@pytest.mark.parametrize(
    ("steps", "fault_text"),
    [
        (["check: {calibration: gone.yaml}"], "There is no such file or folder. Check the path."),
        (["check: {calibration: other.yaml}"], "does not hold a calibrated camera"),
        (["check: {calibration: two.yaml}"], "it holds 2 cameras: cam0, cam1."),
        (["check: {calibration: small.json}"], "640 x 480 px; the station expects 1280 x 720 px."),
        (["check: {calibration: a.yaml}", "check: {calibration: b.yaml}"], "a run checks one"),
    ],
)
def test_a_calibration_that_cannot_be_checked_is_a_fault_before_anything_moves(tmp_path, steps, fault_text):
    (tmp_path / "other.yaml").write_text("a: 1\n")
    (tmp_path / "two.yaml").write_text("cam0: {}\ncam1: {}\n")
    matrix = [800, 0, 320, 0, 800, 240, 0, 0, 1]
    small = {"type": "pinhole", "width": 640, "height": 480, "K": matrix, "D": [0, 0, 0, 0, 0]}
    (tmp_path / "small.json").write_text(json.dumps(small))
    faults, place = planned(tmp_path, *steps), f"sequence.yaml:{4 + len(steps)}:"
    assert any(fault_text in fault and place in fault for fault in faults), faults


def test_a_check_needs_a_calibration_and_results_without_one_have_no_row(tmp_path, solved):
    with pytest.raises(ScriptError, match="calibration: "):
        planned(tmp_path, "check: {model: spherical}")
    assert "check" not in results_of(solved[0])
    assert check_rows(None) == []

"""Recalculated results in a sealed folder: each file follows from the others, and changes are found."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from unittest import mock

import pytest
from kept_calibrations import kept_calibration
from slow_cases import first_quick

from bench.again.recalculated import check_recalculated
from bench.evidence.verify import verify_folder
from bench.solve.offline import calibrate_paths
from bench.solve.offline_folder import write_offline_results
from bench.solve.offline_options import OfflineOptions
from bench.solve.sources import options_data, options_of_data
from calib.boards.board import Board
from tests.unit.bench.evidence.attack_steps import edit
from tests.unit.bench.evidence.resealed import Forger, copied, kinds

pytestmark = pytest.mark.usefixtures("calibrated_once")


@pytest.fixture(scope="module")
def results_once(points, tmp_path_factory, key):
    folder = tmp_path_factory.mktemp("recalculated") / "out"
    with mock.patch("bench.solve.solution.calibrate", kept_calibration):
        result = calibrate_paths([points], OfflineOptions(model="spherical", image_size=(1280, 720)))
    write_offline_results(result, "out", folder, key)
    return folder


@pytest.fixture
def forger(results_once, tmp_path, key):
    return Forger(copied(results_once, tmp_path / "out"), key)


def checked(folder, signers, *, again=True):
    checks = [check_recalculated] if again else []
    return verify_folder(folder, signers, derivations=checks, again=again)


def test_the_numbers_of_untouched_results_are_calculated_again_from_their_sources(results_once, signers):
    verification = checked(results_once, signers)
    assert (verification.faults, verification.not_compared) == ([], [])
    assert verification.kind == "results"
    assert any("last bit" in remark for remark in verification.remarks)


def test_a_recalculation_that_does_not_follow_from_its_sources_is_found_only_by_calculating_again(
    points, signers, key, tmp_path
):
    """Every file of the folder follows from the others: the whole was written anew from a changed calibration."""

    def better(views, options):
        calibration = kept_calibration(views, options)
        return replace(calibration, covariance=calibration.covariance / 100)

    with mock.patch("bench.solve.solution.calibrate", better):
        result = calibrate_paths([points], OfflineOptions(model="spherical", image_size=(1280, 720)))
    write_offline_results(result, "forged", tmp_path / "forged", key)
    assert checked(tmp_path / "forged", signers, again=False).ok
    verification = checked(tmp_path / "forged", signers)
    assert any("calibration.sigma." in fault.what for fault in verification.faults)


HARM = {
    "left.csv is not there": Path.unlink,
    "is another file now": lambda left: left.write_text(left.read_text() + "\n"),
    "other files now": lambda left: shutil.copy(left, left.with_name("again.csv")),
}


@pytest.mark.parametrize("harm", first_quick(HARM))
def test_where_the_sources_are_not_what_they_were_the_numbers_are_not_compared(
    points, tmp_path, signers, key, harm
):
    copy = Path(shutil.copytree(points, tmp_path / "points"))
    result = calibrate_paths([copy], OfflineOptions(model="spherical", image_size=(1280, 720)))
    write_offline_results(result, "out", tmp_path / "out", key)
    HARM[harm](copy / "left.csv")
    verification = checked(tmp_path / "out", signers)
    assert (verification.ok, verification.complete) == (True, False)
    assert harm in " ".join(verification.not_compared)


@pytest.mark.parametrize("made", [None, {"name": "joint", "version": 99}])
def test_results_of_another_engine_within_the_limits_are_confirmed_and_others_are_not(forger, signers, made):
    """Results of earlier versions name no engine."""
    own = forger.results["run"]["software"]["program"]

    def by_another(content):
        content["calibration"].pop("engine")
        content["calibration"] |= {} if made is None else {"engine": made}
        content["run"]["software"]["program"] = "0" * 16

    in_json("results.json", by_another)(forger)
    forger.replace("report.html", own, "0" * 16, -1)
    forger.seal()
    verification = checked(forger.folder, signers)
    assert (verification.faults, verification.not_confirmed) == ([], [])
    in_json("results.json", lambda r: r["calibration"]["sigma"].update(fx=0.5))(forger)
    forger.seal()
    verification = checked(forger.folder, signers)
    assert [what for what in verification.not_confirmed if "calibration.sigma.fx is 0.5" in what]
    assert not verification.complete


def test_options_of_a_later_version_are_refused_by_name():
    data = options_data(OfflineOptions(board=Board.parse("circles:9x6:25mm"), view_numbers=(1, 3)))
    assert options_of_data(json.loads(json.dumps(data)), None, None).view_numbers == (1, 3)
    with pytest.raises(ValueError, match="phase_of_moon"):
        options_of_data({**data, "phase_of_moon": 1}, None, None)


def in_json(name, change):
    return lambda f: f.edit_json(name, change)


ATTACKS = {
    "number": (in_json("results.json", lambda r: r["calibration"]["camera"].update(fx=1.0)), "results.json"),
    "no recalculation": (in_json("results.json", lambda r: r["run"].update(offline=False)), "results.json"),
    "other key named": (in_json("results.json", lambda r: r["run"]["sealed_by"].update(fingerprint="x")), "results.json"),
    "other source": (in_json("results.json", lambda r: r["sources"][0].update(sha256="0" * 64)), "results.json"),
    "source left out": (in_json("sources.json", lambda s: s["sources"].pop()), "results.json"),
    "other camera": (in_json("sources.json", lambda s: s.update(camera_name="other")), "sources.json"),
    "export": (edit("exports/opencv.yaml", "avg_reprojection_error", "best_reprojection_error"), "exports/opencv.yaml"),
    "stars": (lambda f: (f / "views.h5").write_bytes(b"x"), "views.h5"),
    "passport added": (lambda f: (f / "passport.json").write_bytes(b"{}"), "passport.json"),
    "instructions": (edit("VERIFY.txt", "status 0", "status 1"), "VERIFY.txt"),
    "no results": (lambda f: (f / "results.json").write_bytes(b"{}"), "results.json"),
    "sources of nothing": (lambda f: (f / "sources.json").write_bytes(b"[]"), "sources.json"),
}  # fmt: skip


@pytest.mark.parametrize("name", first_quick(ATTACKS, 4))
def test_a_resealed_change_is_found(forger, signers, name):
    attack, where = ATTACKS[name]
    attack(forger)
    forger.seal()
    assert where in {place for _, place in kinds(checked(forger.folder, signers))}

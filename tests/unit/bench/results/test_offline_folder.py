"""An offline calibration in a folder: results, report, exports, and the hashes of its input files."""

import hashlib
import json
from datetime import UTC, datetime
from pathlib import Path

import pytest
from click.testing import CliRunner
from station_texts import PLAIN

from bench.base.errors import UsageError
from bench.commands.cli import cli
from bench.commands.keys import key_or_draft
from bench.evidence.keys import create_key
from bench.evidence.verify import verify_folder
from bench.results.again_recalculated import check_recalculated
from bench.results.offline import calibrate_paths
from bench.results.offline_folder import require_new, write_offline_results
from bench.results.offline_options import OfflineOptions
from bench.results.passports import passport_from_certificate, write_passport
from bench.results.solve_options import ONE_VIEW
from calib.errors import DegenerateViews
from tests.support.printed_text import printed_text


@pytest.fixture(scope="module")
def passport(tmp_path_factory):
    """A passport file of a certificate."""
    path = tmp_path_factory.mktemp("passport") / "p.json"
    made = passport_from_certificate(
        255, 0.05, number="T-1", issued=None, collimator=None, temperature_c=None, now=datetime.now(UTC)
    )
    write_passport(path, made)
    return str(path)


def options(points, **given):
    common = dict.fromkeys(("model", "distortion", "loss", "views", "station"))
    return OfflineOptions.from_command_line(
        **{**common, "image_size": "1280x720", "image": "auto", "origin": "corner", **given}
    )


def test_the_folder_holds_results_report_exports_and_the_hashes_of_the_inputs(points, passport, tmp_path):
    result = calibrate_paths([points], options(points, passport=passport))
    write_offline_results(result, tmp_path / "out")
    found = json.loads((tmp_path / "out" / "results.json").read_text())
    assert found["schema"] == "starbench/results/1"
    assert (found["run"]["offline"], found["run"]["simulated"]) == (True, False)
    assert found["calibration"]["camera"] == result.calibration.to_dict()["camera"]
    sources = json.loads((tmp_path / "out" / "sources.json").read_text())["sources"]
    assert sources == found["sources"]
    for source in sources:
        data = (points / f"{source['view']}.csv").read_bytes()
        assert (source["size_bytes"], source["sha256"]) == (len(data), hashlib.sha256(data).hexdigest())
    assert (tmp_path / "out" / "passport.json").read_bytes() == Path(passport).read_bytes()
    assert found["passport"]["source"] == "command line"
    assert len(list((tmp_path / "out" / "exports").iterdir())) >= 5
    text = " ".join(printed_text((tmp_path / "out" / "report.html").read_text()))
    assert "OFFLINE: calibrated from existing files, without devices." in text
    assert sources[0]["sha256"] in text
    assert "DRAFT: Starbench made this report from existing files, and no seal protects it" in text
    assert not (tmp_path / "out" / "SHA256SUMS").exists()
    assert "number T-1" in text


def test_the_folder_is_sealed_and_says_that_it_is_a_recalculation(points, tmp_path, key, signers):
    write_offline_results(calibrate_paths([points], options(points)), tmp_path / "out", key)
    found = json.loads((tmp_path / "out" / "results.json").read_text())
    assert found["run"]["sealed_by"] == {"principal": key.principal, "fingerprint": key.fingerprint}
    assert "a recalculation" in found["run"]["statement"]
    assert found["run"]["of_runs"] == []
    text = " ".join(printed_text((tmp_path / "out" / "report.html").read_text()))
    assert "This is a recalculation, not the record of a run." in text
    assert f"{key.principal} sealed it" in text
    assert "DRAFT" not in text
    assert "a recalculation" in (tmp_path / "out" / "VERIFY.txt").read_text()
    assert verify_folder(tmp_path / "out", signers).state == "SEALED"
    assert all(path.is_dir() or not path.stat().st_mode & 0o222 for path in (tmp_path / "out").rglob("*"))


@pytest.mark.parametrize("trouble", [None, "no key", "readable"])
def test_without_a_usable_key_the_folder_stays_a_draft(tmp_path, monkeypatch, capsys, trouble):
    home = tmp_path / "home"
    monkeypatch.setenv("STARBENCH_HOME", str(home))
    if trouble != "no key":
        create_key(home)
    if trouble == "readable":
        (home / "bench_key").chmod(0o644)
    key = key_or_draft()
    assert (key is None) is (trouble is not None)
    assert ("DRAFT: the results will not be sealed." in capsys.readouterr().err) is (trouble is not None)
    assert (home / "bench_key").exists() is (trouble != "no key")


def test_metavision_s_json_describes_the_target_of_the_station(points, tmp_path):
    station = tmp_path / "station.yaml"
    station.write_text(PLAIN + "target: {squares: [60, 80], pitch_mm: 4.0, tag_square: [20, 30]}\n")
    result = calibrate_paths([points], options(points, station=str(station)))
    write_offline_results(result, tmp_path / "out")
    pattern = json.loads((tmp_path / "out" / "exports" / "metavision.json").read_text())["pattern"]
    assert (pattern["n_cols"], pattern["n_rows"], pattern["square_width"]) == (60, 80, 0.004)


def test_the_station_file_of_the_target_is_stated_with_its_hash(points, tmp_path, key, signers):
    station = tmp_path / "station.yaml"
    station.write_text(PLAIN)
    result = calibrate_paths([points], options(points, station=str(station)))
    write_offline_results(result, tmp_path / "out", key)
    described = json.loads((tmp_path / "out" / "sources.json").read_text())
    hashed = hashlib.sha256(PLAIN.encode()).hexdigest()
    assert described["station"] == {"name": str(station), "path": str(station), "sha256": hashed}

    def remarks_and_faults():
        found = check_recalculated(tmp_path / "out")
        return [remark for remark in found.remarks if "station file" in remark], [
            str(f) for f in found.faults
        ]

    assert remarks_and_faults() == ([], [])
    described["option_target"]["pitch_mm"] += 1
    described["station"]["sha256"] = hashed
    sources = tmp_path / "out" / "sources.json"
    sources.chmod(0o644)
    sources.write_text(json.dumps(described))
    _, faults = remarks_and_faults()
    assert f"by the station file {station}" in faults[0]
    station.write_text(PLAIN + "target: {squares: [60, 80], pitch_mm: 4.0, tag_square: [20, 30]}\n")
    assert "another station file lies there now" in remarks_and_faults()[0][0]
    station.unlink()
    assert "is not there any more" in remarks_and_faults()[0][0]


def test_an_included_station_is_stated_and_none_is_none(points):
    read = options(points, station="simulated").station
    assert read.name == "simulated"
    assert hashlib.sha256(Path(read.path).read_bytes()).hexdigest() == read.sha256
    assert options(points).station is None


def test_a_folder_with_anything_in_it_is_refused(tmp_path):
    require_new(tmp_path / "none")
    require_new(tmp_path)
    (tmp_path / "note.txt").touch()
    with pytest.raises(UsageError, match=r"note\.txt"):
        require_new(tmp_path)


def test_the_command_refuses_the_folder_before_it_calibrates(points, tmp_path):
    (tmp_path / "note.txt").touch()
    found = CliRunner().invoke(cli, ["calibrate", str(points / "nothing.csv"), "-o", str(tmp_path)])
    assert found.exit_code != 0
    assert not (tmp_path / "results.json").exists()


def test_a_passport_is_used_and_none_switches_it_off(points, passport):
    assert calibrate_paths([points], options(points, passport=passport)).calibration.model == "joint"
    assert calibrate_paths([points], options(points, passport="none")).passport is None
    spherical = calibrate_paths([points], options(points, passport=passport, model="spherical"))
    assert spherical.calibration.model == "spherical"
    planar = calibrate_paths([points], options(points, passport=passport, model="planar"))
    assert (planar.calibration.model, planar.passport) == ("planar", None)


def test_one_view_without_a_passport_of_the_centre_says_what_one_would_give(points, passport, tmp_path):
    for given in (None, passport):
        with pytest.raises(DegenerateViews) as caught:
            calibrate_paths([points / "left.csv"], options(points, passport=given))
        assert ONE_VIEW in str(caught.value)
    whole = calibrate_paths([points], options(points)).calibration.passport()
    write_passport(tmp_path / "whole.json", whole)
    one = calibrate_paths([points / "left.csv"], options(points, passport=str(tmp_path / "whole.json")))
    assert one.calibration.sigma["fx"] < 0.02 * one.calibration.camera.fx

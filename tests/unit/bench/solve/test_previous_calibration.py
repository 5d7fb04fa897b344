"""The last calibration of the same camera: found by the ledger, believed only if seal and hash are right."""

import copy
import hashlib

import pytest
from report_sample import SMALL, sample

from bench.base.bounded_json import canonical_json
from bench.solve.result import FIRST, previous_calibration


class Bench:
    """A ledger, and sealed folders of runs with results."""

    def __init__(self, path, ledger):
        self.path, self.ledger = path, ledger
        self.results = sample(size=SMALL).results

    def run(self, name, *, change=lambda _: None, camera="00050423", simulated=True, how="finished"):
        """Enter a run, write its results, seal it and end it; return its place in the ledger."""
        folder = self.path / name
        folder.mkdir()
        place = self.ledger.begin(run_id=name, folder=folder, camera=camera, simulated=simulated)
        results = copy.deepcopy(dict(self.results))
        change(results)
        data = canonical_json(results)
        (folder / "results.json").write_bytes(data)
        (folder / "SHA256SUMS").write_text(f"{hashlib.sha256(data).hexdigest()}  results.json\n")
        (folder / "SHA256SUMS.sig").write_text("signature")
        self.ledger.end(place["number"], how=how, folder=folder)
        return place

    def of(self, name, **more):
        """What a run that begins now finds, if its own results are those of the sample."""
        place = self.ledger.begin(
            run_id=name, folder=self.path / name, **{"camera": "00050423", "simulated": True, **more}
        )
        return previous_calibration(self.ledger, place, self.results)


@pytest.fixture
def bench(tmp_path, ledger):
    return Bench(tmp_path, ledger)


def test_the_first_calibration_is_called_so(bench):
    bench.run("other camera", camera="7")
    bench.run("real", simulated=False)
    bench.run("failed", how="failed")
    assert bench.of("now") == {"run": None, "why_not": FIRST}
    assert previous_calibration(bench.ledger, {}, bench.results) is None


def test_the_last_one_is_copied_with_its_hashes_and_compared(bench):
    bench.run("first", change=lambda r: r["calibration"]["camera"].update(fx=9999.0))
    bench.run("second", change=lambda r: r["calibration"]["camera"].update(cy=360.0))
    previous = bench.of("now")
    assert (previous["run"], previous["number"], previous["temperature_c"]) == ("second", 2, 41.27)
    data = (bench.path / "second" / "results.json").read_bytes()
    assert previous["results_sha256"] == hashlib.sha256(data).hexdigest()
    seal = (bench.path / "second" / "SHA256SUMS").read_bytes()
    assert previous["seal"] == hashlib.sha256(seal).hexdigest()
    assert previous["calibration"]["camera"]["cy"] == 360.0
    assert list(previous["calibration"]["sigma"]) == ["fx", "fy", "cx", "cy", "k1", "k2"]
    assert previous["change"].largest_px >= previous["change"].rms_px > 0
    assert previous["change"].largest_ratio > 0


def test_a_camera_that_is_only_turned_has_not_changed(bench):
    bench.run("same")
    change = bench.of("now")["change"]
    assert change.largest_px < 1e-6
    assert change.largest_ratio < 1e-6


def test_runs_after_this_one_are_not_before_it(bench):
    place = bench.ledger.begin(run_id="slow", folder=bench.path / "slow", camera="00050423", simulated=True)
    bench.run("later")
    assert previous_calibration(bench.ledger, place, bench.results) == {"run": None, "why_not": FIRST}


def in_calibration(**facts):
    return {"change": lambda results: results["calibration"].update(facts)}


WITH_LENS = {"change": lambda results: results["devices"]["camera"].update(lens="50 mm")}


@pytest.mark.parametrize(
    ("run", "spoil", "reason"),
    [
        ({}, lambda f: (f / "results.json").write_text("{}"), "its results were changed after sealing."),
        ({}, lambda f: (f / "results.json").unlink(), "its folder cannot be read."),
        ({}, lambda f: (f / "SHA256SUMS").write_text("\n"), "its folder has another seal than the ledger."),
        (in_calibration(converged=False), None, "it did not converge."),
        (in_calibration(image_size=[640, 480]), None, "its images had another size."),
        (in_calibration(covariance={"names": [], "matrix": []}), None, "its uncertainties are not complete."),
        (WITH_LENS, None, "the camera had another lens: 50 mm."),
        ({"change": lambda r: r.pop("calibration")}, None, "its results are not readable."),
    ],
)
def test_what_cannot_be_compared_is_named_and_gives_way_to_an_earlier_one(bench, run, spoil, reason):
    bench.run("bad", **run)
    if spoil:
        spoil(bench.path / "bad")
    previous = bench.of("now")
    assert previous["run"] is None
    assert previous["why_not"].endswith(f"bad, cannot be compared: {reason}")
    bench.run("good")
    bench.run("worse", **run)
    if run:
        assert bench.of("then")["run"] == "good"


def test_a_broken_ledger_is_told(bench):
    bench.run("old")
    place = bench.ledger.begin(run_id="now", folder=bench.path / "now", camera="00050423", simulated=True)
    bench.ledger.path.write_text("x\n")
    assert "cannot be read" in previous_calibration(bench.ledger, place, bench.results)["why_not"]

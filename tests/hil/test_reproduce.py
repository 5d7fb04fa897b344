"""Results that follow from their recordings, and results that do not."""

import json
import shutil

import pytest
from running import starbench

from bench.evidence.keys import load_key
from bench.results.again_run import check_run_again
from bench.results.result import json_bytes
from tests.unit.bench.evidence.resealed import reseal


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    return tmp_path_factory.mktemp("home")


@pytest.fixture(scope="module")
def finished(tmp_path_factory, home):
    folder = tmp_path_factory.mktemp("runs") / "run"
    said = starbench("run", "three_pose", "-s", "simulated", "--seed", 3, "-o", folder, home=home)
    assert said.returncode == 0, said.stderr
    return folder


@pytest.fixture
def copied(finished, tmp_path):
    """The run, writable, for a test to tamper with."""
    copy = tmp_path / "copy"
    shutil.copytree(finished, copy)
    for path in [copy, *copy.rglob("*")]:
        path.chmod(0o755 if path.is_dir() else 0o644)
    return copy


def test_what_a_run_found_follows_from_its_recordings(finished, home):
    said = starbench("verify", finished, "--again", "--json", home=home)
    assert said.returncode == 0, said.stdout
    found = json.loads(said.stdout)
    assert (found["faults"], found["not_compared"], found["complete"]) == ([], [], True)
    assert any("equal to the last bit" in remark for remark in found["remarks"])


def test_recordings_that_are_not_what_the_results_were_made_of_are_found(copied):
    one, two, three = (copied / f"captures/pose-00{n}-attempt-1.raw" for n in (1, 2, 3))
    shutil.copy(one, two)
    assert check_run_again(copied).faults != []
    three.write_bytes(b"% nothing\n")
    assert "cannot be calibrated again" in " ".join(str(fault) for fault in check_run_again(copied).faults)


def test_a_bundle_resealed_over_edited_results_is_found(copied, home):
    """The bench's own key is no help against a bench that tells something else than it saw."""
    results = json.loads((copied / "results.json").read_bytes())
    results["calibration"]["camera"]["fx"] += 5
    (copied / "results.json").write_bytes(json_bytes(results))
    reseal(copied, load_key(home))
    said = starbench("verify", copied, "--json", home=home)
    assert said.returncode == 1
    assert "results.json" in {fault["where"] for fault in json.loads(said.stdout)["faults"]}
    (fault, *_) = check_run_again(copied).faults
    assert (fault.kind, fault.where) == ("results", "results.json")
    assert "calibration.camera.fx is " in fault.what

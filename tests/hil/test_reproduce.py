"""Results that follow from their recordings, and results that do not."""

import json
import shutil

import pytest
from running import starbench

from bench.records.run_folder import RunFolder
from bench.results.reproduce import differences


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


def edit(folder, change):
    results = json.loads((folder / "results.json").read_bytes())
    change(results["calibration"])
    (folder / "results.json").write_text(json.dumps(results))


def test_what_a_run_found_follows_from_its_recordings(finished, home):
    said = starbench("verify", finished, "--again", "--json", home=home)
    assert said.returncode == 0, said.stdout
    assert json.loads(said.stdout)["faults"] == []


def test_recordings_that_are_not_what_the_results_were_made_of_are_found(copied):
    one, two, three = (copied / f"captures/pose-00{n}-attempt-1.raw" for n in (1, 2, 3))
    shutil.copy(one, two)
    assert differences(copied) != []
    three.write_bytes(b"% nothing\n")
    (found,) = differences(copied)
    assert found.startswith("the run cannot be calibrated again")


def test_a_bundle_resealed_over_edited_results_is_found(copied, home):
    """The bench's own key is no help against a bench that tells something else than it saw."""
    from bench.evidence.keys import load_key, read_signers
    from bench.evidence.seal import seal
    from bench.evidence.verify import verify_folder

    (copied / "SHA256SUMS.sig").unlink()
    (copied / "report.html").unlink()
    edit(copied, lambda calibration: calibration["camera"].update(fx=calibration["camera"]["fx"] + 5))
    with RunFolder.open(copied) as folder:
        seal(folder, load_key(home))
    signers = read_signers(home / "allowed_signers")
    assert verify_folder(copied, signers).ok
    (fault,) = verify_folder(copied, signers, recalculate=differences).faults
    assert (fault.kind, fault.where) == ("results", "results.json")
    assert "the recordings give fx" in fault.what

"""A stored run is opened in one place: each part is checked once, and what has another form is named at its place."""

import json
from pathlib import Path

import pytest

from bench.base.bounded_json import canonical_json
from bench.base.errors import JournalBroken, RunFolderError, StorageError
from bench.record.stored_run import StoredRun, results_of

RESULTS = Path(__file__).parents[3] / "support" / "certificate_results.json"


def changed(change):
    results = json.loads(RESULTS.read_text(encoding="utf-8"))
    change(results)
    return json.dumps(results).encode()


def test_results_are_checked_and_kept_as_they_are():
    data = RESULTS.read_bytes()
    assert json.loads(canonical_json(results_of(data, RESULTS))) == json.loads(data)


@pytest.mark.parametrize(
    ("change", "place"),
    [
        (lambda r: r["calibration"].pop("camera"), "calibration.camera is missing"),
        (lambda r: r["calibration"]["sigma"].update(fx="3"), "calibration.sigma.fx is of another type"),
        (lambda r: r["poses"][1].pop("name"), "poses.1.name is missing"),
        (lambda r: r.update(run=None), "run is of another type"),
    ],
)  # fmt: skip
def test_the_first_value_of_another_form_is_named_at_its_place(change, place):
    with pytest.raises(RunFolderError, match=place.replace(".", r"\.")):
        results_of(changed(change), RESULTS)


@pytest.mark.parametrize("data", [b"", b"[]", b"{", b'{"a": 1, "a": 2}', b"\xff", b"[" * 100_000])
def test_what_is_no_json_of_results_is_refused_in_words(data):
    with pytest.raises(RunFolderError, match="The results"):
        results_of(data, RESULTS)


def test_a_folder_without_a_journal_is_no_run(tmp_path):
    with pytest.raises(RunFolderError, match=r"no journal\.jsonl"):
        StoredRun.open(tmp_path)
    with pytest.raises(StorageError):
        _ = StoredRun(tmp_path).results


def test_the_parts_of_a_sealed_run(sealed):
    run = StoredRun.open(sealed)
    assert run.is_sealed
    assert (run.torn, run.is_rehearsal) == (b"", False)
    assert run.head == run.entries[-1].hash
    assert run.history.ended == "finished"
    assert run.entries is run.entries  # read once
    journal = sealed / "journal.jsonl"
    journal.chmod(0o600)
    journal.write_bytes(journal.read_bytes().replace(b'"finished"', b'"failed00"', 1))
    with pytest.raises(JournalBroken):
        _ = StoredRun.open(sealed).history

"""A run and the ledger: a break is told to the operator, journaled and reported; a strict station refuses it."""

from types import SimpleNamespace

import pytest

from bench.base.errors import EvidenceError, RunFolderError
from bench.report.run_tables import identification
from bench.run.ledger_entry import enter_in_ledger, ledger_entry, ledger_lines, refuse_broken_ledger
from bench.run.runner import RunEnd
from bench.stations.station import LedgerConfig


def job(**section):
    camera = SimpleNamespace(serial="00050423")
    return SimpleNamespace(
        station=SimpleNamespace(ledger=LedgerConfig(**section), camera=camera), simulated=True
    )


def run(ledger, folder, task, known=None):
    place = enter_in_ledger(ledger, task, folder, known)
    with ledger_entry(ledger, place, folder) as ending:
        ending(RunEnd("aborted", "", folder, None))
    return place


def test_a_break_is_told_and_stands_in_the_place_and_in_the_report(ledger, tmp_path):
    run(ledger, tmp_path / "a", job())
    ledger.path.unlink()
    place = run(ledger, tmp_path / "b", job())
    (line,) = ledger_lines(place)
    assert line.startswith("FAULT OF THE LEDGER: On 2026-03-01 00:00 UTC")
    assert line.endswith("`starbench ledger --explain TEXT`.")
    (row,) = [value for name, value in identification({"run": {"ledger": place}}) if name == "Ledger"]
    assert row.startswith("BROKEN. On 2026-03-01")


def test_a_strict_station_refuses_a_break_before_anything_is_made(ledger, tmp_path):
    task = job(strict=True)
    run(ledger, tmp_path / "a", task)
    refuse_broken_ledger(ledger, task)
    ledger.path.unlink()
    refuse_broken_ledger(ledger, job())
    for refused in (refuse_broken_ledger, lambda *words: enter_in_ledger(*words, tmp_path / "b")):
        with pytest.raises(EvidenceError, match="The ledger is broken"):
            refused(ledger, task)
    assert not ledger.path.exists()


def test_a_run_that_is_resumed_keeps_its_place_unless_the_ledger_has_lost_it(ledger, tmp_path):
    place = run(ledger, tmp_path / "a", job())
    assert enter_in_ledger(ledger, job(), tmp_path / "a", place) == place
    (ledger.home / "ledger_high").unlink()
    ledger.path.write_bytes(ledger.path.read_bytes().splitlines(keepends=True)[0])
    seen = enter_in_ledger(ledger, job(), tmp_path / "a", place)
    assert seen == place  # the line is there, and nothing else knows of the lost one
    ledger.path.write_bytes(b"junk\n")
    again = enter_in_ledger(ledger, job(), tmp_path / "a", place)
    assert again["head"] != place["head"]
    assert "was damaged" in again["faults"][0]


def test_a_run_that_a_copy_of_its_folder_has_ended_is_not_resumed(ledger, tmp_path):
    place = run(ledger, tmp_path / "a", job())
    (copy := tmp_path / "copy").mkdir()
    for name in ("SHA256SUMS", "SHA256SUMS.sig"):
        (copy / name).write_text("sealed")
    run(ledger, copy, job(), place)
    assert ledger.faults() == []
    with pytest.raises(RunFolderError, match=f"starbench verify {copy}"):
        enter_in_ledger(ledger, job(), tmp_path / "a", place)
    (copy / "SHA256SUMS.sig").unlink()
    run(ledger, tmp_path / "a", job(), place)
    assert ledger.runs()[0].folder == str(copy)


def test_a_resumed_run_tells_of_a_break_too(ledger, tmp_path):
    place = run(ledger, tmp_path / "a", job())
    run(ledger, tmp_path / "b", job())
    ledger.path.write_bytes(b"".join(ledger.path.read_bytes().splitlines(keepends=True)[:2]))
    assert "2 are missing" in enter_in_ledger(ledger, job(), tmp_path / "a", place)["faults"][0]
    with pytest.raises(EvidenceError):
        enter_in_ledger(ledger, job(strict=True), tmp_path / "a", place)


def test_a_station_that_names_a_second_place_is_told_that_it_is_not_used(ledger, tmp_path):
    anchor = tmp_path / "bench2.heads"
    place = run(ledger, tmp_path / "a", job(anchor=str(anchor), strict=True))
    assert "faults" not in place
    assert any(line.startswith("WARNING: ") and "ledger.anchor" in line for line in ledger_lines(place))
    assert not anchor.exists()

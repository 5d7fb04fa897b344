"""Ledgers of several benches: what is double, missing, changed or set back is named, and nothing else is."""

import json
import re
import shutil
from datetime import timedelta

import pytest
from many_runs import BEGIN, BenchOfRuns, write_run

from bench.base.clock import VirtualClock
from bench.evidence.merged_runs import (
    IN_LEDGER,
    NO_LEDGER,
    NOT_IN_LEDGER,
    EnteredRun,
    LedgerSource,
    MergedLedgers,
    merge_ledgers,
    merge_runs,
    read_source,
)
from bench.record.ledger import LEDGER, Ledger
from bench.record.ledger_marks import LedgerMark, LedgerRun, write_own_mark
from bench.record.run_index import RunIndex, run_folders


def bench(folder, runs=3, **facts):
    """A bench with some runs; its configuration folder, and the runs in ``folder / "runs"``."""
    made = BenchOfRuns(folder / "home", folder / "runs", **facts)
    for hour in range(runs):
        made.run(begun=BEGIN + timedelta(hours=hour))
    made.close()
    return folder / "home"


def sources(*homes):
    return [read_source(Ledger(home, VirtualClock(BEGIN))) for home in homes]


def merge(tmp_path, *homes, folders=(), **facts):
    return merge_runs(RunIndex(tmp_path / "here"), merge_ledgers(sources(*homes)), folders, **facts)


@pytest.fixture
def two(tmp_path):
    return bench(tmp_path / "a"), bench(tmp_path / "b", 2, station="Bench 2")


def cut(home, lines):
    """Set a ledger and its own mark back to what they were after its first lines."""
    kept = (home / LEDGER).read_bytes().splitlines(keepends=True)[:lines]
    (home / LEDGER).write_bytes(b"".join(kept))
    last = json.loads(kept[-1])
    write_own_mark(home, LedgerMark(lines, last["number"], last["hash"], last["utc"]))


def test_two_benches_become_one_list_with_the_same_numbers_kept_apart(tmp_path, two):
    merged = merge(tmp_path, *two)
    assert (merged.faults, merged.notes) == ([], [])
    assert [run.ledger_number for run in merged.runs] == [1, 1, 2, 2, 3]  # by time
    assert {place.state for place in merged.places.values()} == {IN_LEDGER}
    assert len({place.ledger for place in merged.places.values()}) == 2


def test_a_ledger_named_twice_and_an_older_copy_count_once(tmp_path, two):
    old = tmp_path / "old"
    shutil.copytree(two[0], old)
    cut(old, 4)
    merged = merge(tmp_path, two[0], two[0], old)
    assert len(merged.runs) == 3
    assert merged.faults == []
    assert "named twice" in merged.notes[0]


def test_a_missing_folder_and_one_with_another_run_are_faults(tmp_path, two):
    runs = tmp_path / "a" / "runs"
    for name in ("run-00002", "run-00003"):
        shutil.rmtree(runs / name)
    shutil.copytree(tmp_path / "b" / "runs" / "run-00001", runs / "run-00003")
    merged = merge(tmp_path, two[0])
    missing, other = merged.faults
    assert missing.startswith("run 2 of home (run-00002, finished)")
    assert missing.endswith("is missing")
    assert "(number 1)" in other
    assert [run.id for run in merged.runs] == ["run-00001", "run-00001"]
    assert [merged.places[run.folder].state for run in merged.runs] == [IN_LEDGER, NOT_IN_LEDGER]
    (unknown,) = merged.notes
    assert f"not given: {runs / 'run-00003'}" in unknown


def test_folders_that_were_copied_elsewhere_are_found_by_their_line(tmp_path, two):
    shutil.move(tmp_path / "a" / "runs", tmp_path / "central")
    merged = merge(tmp_path, two[0], folders=run_folders(tmp_path / "central"))
    assert merged.faults == []
    assert len(merged.runs) == 3
    assert {place.state for place in merged.places.values()} == {IN_LEDGER}


def test_a_copy_counts_once_and_a_copy_with_another_content_is_a_fault(tmp_path, two):
    first, copies = tmp_path / "a" / "runs" / "run-00001", tmp_path / "copies"
    same, other, results = (shutil.copytree(first, copies / name) for name in ("same", "journal", "results"))
    journal = other / "journal.jsonl"
    journal.write_bytes(b"".join(journal.read_bytes().splitlines(keepends=True)[:-1]))
    (results / "results.json").write_text("{}")
    merged = merge(tmp_path, two[0], folders=run_folders(copies))
    assert [run.folder for run in merged.runs if run.id == "run-00001"] == [str(first)]
    (note,) = merged.notes
    assert re.match(f"{same} .* {first}", note)
    of_journal, of_results = merged.faults
    assert of_journal.startswith(f"{other} is ")
    assert "another journal.jsonl" in of_journal
    assert of_results.startswith(f"{results} is ")
    assert "another results.json" in of_results


def test_changed_results_and_a_broken_journal_are_one_fault_each(tmp_path, two):
    folder = tmp_path / "a" / "runs" / "run-00001"
    assert merge(tmp_path, two[0]).faults == []
    (folder / "results.json").write_text("{}")
    (changed,) = merge(tmp_path, two[0]).faults
    assert changed.startswith(f"{folder}: results.json was changed")
    journal = tmp_path / "a" / "runs" / "run-00002" / "journal.jsonl"
    journal.write_bytes(journal.read_bytes().replace(b"Three poses", b"Three Poses"))
    merged = merge(tmp_path, two[0])
    (broken,) = set(merged.faults) - {changed}
    assert "run-00002" in broken
    assert [run.id for run in merged.runs] == ["run-00001", "run-00003"]


def test_a_removed_seal_is_named(tmp_path, two):
    folder = tmp_path / "a" / "runs" / "run-00001"
    (run,) = RunIndex(tmp_path / "here").runs([folder])[0]
    entered = LedgerRun(
        1, run.id, str(folder), run.camera, False, run.begun_utc, "finished", "e" * 64, run.ledger_head
    )
    ledgers = MergedLedgers([LedgerSource(two[0], "a")], {run.ledger_head: EnteredRun(entered, "a", "x")})
    (fault,) = merge_runs(RunIndex(tmp_path / "here"), ledgers, []).faults
    assert fault.endswith("removed.")
    for name in ("SHA256SUMS", "SHA256SUMS.sig"):
        (folder / name).write_text("x")
    (fault,) = merge_runs(RunIndex(tmp_path / "here"), ledgers, []).faults
    assert "another seal" in fault


def test_a_damaged_ledger_is_a_fault_and_its_runs_are_not_lost(tmp_path, two):
    text = (two[0] / LEDGER).read_bytes()
    (two[0] / LEDGER).write_bytes(text.replace(b'"number":2', b'"number":9', 1))
    merged = merge(tmp_path, *two, folders=run_folders(tmp_path / "a" / "runs"))
    assert any("The ledger is damaged" in fault for fault in merged.faults)
    assert len(merged.runs) == 5


def test_rehearsals_and_runs_without_a_place_are_listed_without_a_fault(tmp_path, two):
    write_run(tmp_path / "more" / "rehearsed", rehearsal=True)
    merged = merge(tmp_path, two[0], folders=run_folders(tmp_path / "more"), only_folders=True)
    (run,) = merged.runs
    assert merged.places[run.folder].state == NO_LEDGER
    assert (merged.faults, merged.notes) == ([], [])

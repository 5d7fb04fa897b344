"""Breaks of the ledger: whatever is taken out of it is noticed by the next run, by a check, and by a certificate."""

from pathlib import Path
from unittest import mock

import pytest
from journals import CLOCK

from bench.base.errors import EvidenceError, StorageError, UsageError
from bench.record.journal import Journal
from bench.record.ledger_marks import MARK, RunFault, highest_counts


def begin(ledger, run="run", **more):
    return ledger.begin(run_id=run, folder=Path("/runs") / run, camera="1", simulated=False, **more)


def runs(ledger, count, **more):
    for number in range(count):
        place = begin(ledger, f"run{number}", **more)
        ledger.end(place["number"], how="finished", folder=Path("/runs/none"))


def cut(ledger, lines):
    ledger.path.write_bytes(b"".join(ledger.path.read_bytes().splitlines(keepends=True)[:lines]))


def faults(ledger, *words):
    return ledger.breaks(*words)[0]


def test_a_rollback_to_two_lines_is_noticed_by_a_check_a_certificate_and_the_next_run(ledger):
    runs(ledger, 3)
    cut(ledger, 2)
    (fault,) = faults(ledger)
    assert "2 of at least 6 lines" in fault
    with pytest.raises(EvidenceError, match="4 are missing"):
        ledger.append("certificate_issued", number=1)
    place = begin(ledger, "next")
    assert place["number"] == 4  # the numbers of the lost runs are not given again
    assert "4 are missing" in place["faults"][0]
    assert "starbench ledger --explain" in place["faults"][0]


def test_a_rollback_that_has_grown_again_to_its_old_length_is_noticed(ledger):
    runs(ledger, 3)
    copy = ledger.path.read_bytes()
    cut(ledger, 2)
    mark = (ledger.home / MARK).read_bytes()
    (ledger.home / MARK).unlink()
    with mock.patch("bench.record.ledger.find_breaks") as find_breaks:
        find_breaks.return_value = mock.Mock(what=(), known=(), warnings=())
        runs(ledger, 2)
    (ledger.home / MARK).write_bytes(mark)
    assert len(ledger.path.read_bytes().splitlines()) == len(copy.splitlines())
    assert "has another line 6" in faults(ledger)[0]


def test_an_end_is_entered_though_the_ledger_was_deleted_and_no_number_is_given_twice(ledger):
    runs(ledger, 1)
    place = begin(ledger)
    ledger.path.unlink()
    assert "has 0 of at least 3 lines" in faults(ledger)[0]
    ledger.end(place["number"], how="finished", folder=Path("/runs/none"))
    assert [e.event for e in ledger.entries()] == ["ledger_broken", "run_ended"]
    assert [known["runs"] for known in ledger.entries()[0].data["known"]] == [2]
    assert ledger.runs() == []
    assert begin(ledger)["number"] == 3


def test_a_damaged_ledger_is_kept_and_does_not_stop_a_run(ledger):
    runs(ledger, 2)
    lines = ledger.path.read_bytes().splitlines(keepends=True)
    ledger.path.write_bytes(lines[0] + lines[2])
    assert "damaged" in faults(ledger)[0]
    place = begin(ledger)
    assert place["number"] == 3
    assert "The ledger was damaged" in place["faults"][0]
    kept = next(ledger.home.glob("ledger-broken-*.jsonl"))
    assert kept.read_bytes() == lines[0] + lines[2]
    assert ledger.entries()[0].data["kept"].startswith(kept.name)


@pytest.mark.parametrize("lines", [4, 2], ids=["whole", "set back to its first run"])
def test_the_own_mark_deleted_is_noticed_even_where_nothing_else_tells(ledger, lines):
    runs(ledger, 2)
    cut(ledger, lines)
    (ledger.home / MARK).unlink()
    (fault,) = faults(ledger)
    assert "(ledger_high) was deleted" in fault
    assert "ledger_high" in begin(ledger)["faults"][0]
    assert len(faults(ledger)) == 1  # recorded once


@pytest.mark.parametrize(
    "content", [b"", b"{}", b"[1]", b'{"lines":0}', b"\xff", b"[" * 100_000, b'{"lines":true}']
)
def test_an_own_mark_of_another_program_is_noticed(ledger, content):
    runs(ledger, 1)
    (ledger.home / MARK).write_bytes(content)
    assert "cannot be read" in faults(ledger)[0]
    assert "faults" in begin(ledger)


def test_a_process_killed_after_the_first_line_of_a_ledger_leaves_no_break(ledger):
    ledger.home.mkdir()
    with Journal.create(ledger.path, CLOCK) as journal:
        journal.append("run_begun", number=1, run="r", folder="/r", camera="1", simulated=False)
    assert ledger.breaks() == ([], [])
    assert begin(ledger)["number"] == 2


def test_an_explained_break_stands_in_the_ledger_and_is_no_fault_any_more(ledger):
    runs(ledger, 2)
    cut(ledger, 2)
    with pytest.raises(EvidenceError, match="starbench ledger --explain"):
        begin(ledger, strict=True)
    with pytest.raises(EvidenceError):
        ledger.refuse_break()
    assert len(ledger.entries()) == 2
    begin(ledger)
    with pytest.raises(EvidenceError, match="starbench ledger --explain"):  # recorded, but not explained
        begin(ledger, strict=True)
    assert "2 are missing" in ledger.explain("A copy of Monday.", "Ada")[0]
    breaks, explained = ledger.breaks()
    assert breaks == []
    assert [(line.reason, line.by) for line in explained] == [("A copy of Monday.", "Ada")]
    assert begin(ledger, strict=True)["number"] == 4
    with pytest.raises(UsageError, match="no break"):
        ledger.explain("again", "Ada")


def test_a_home_that_cannot_be_written_after_the_begin_stops_no_run(ledger):
    failed = StorageError("The disk is full.", where="ledger_high")
    with mock.patch("bench.record.ledger.write_own_mark", side_effect=failed):
        assert begin(ledger)["number"] == 1
    assert "disk is full" in ledger.warnings[0]


def test_a_break_keeps_the_highest_number_of_each_series(ledger):
    runs(ledger, 1)
    for count in (1, 2):
        ledger.append("certificate_reserved", number=f"2026-{count:04}", series="2026", count=count)
    ledger.path.unlink()
    begin(ledger)
    assert highest_counts(ledger.entries()) == {"2026": 2}


# ---------------------------------------------------------------- a run whose disk was taken away


@pytest.fixture
def lost_run(ledger, tmp_path):
    """A sealed run, by the ledger, whose folder has gone; the folder."""
    folder = tmp_path / "disk" / "run"
    folder.mkdir(parents=True)
    for name in ("SHA256SUMS", "SHA256SUMS.sig"):
        (folder / name).write_text("sealed")
    place = ledger.begin(run_id="run", folder=folder, camera="1", simulated=False)
    ledger.end(place["number"], how="finished", folder=folder)
    assert ledger.faults() == []
    folder.rename(tmp_path / "taken away")
    return folder


def test_a_lost_run_is_a_fault_until_a_person_says_what_became_of_it(ledger, lost_run):
    (fault,) = map(str, ledger.faults())
    assert f"its folder {lost_run} is missing" in fault
    (shown,) = ledger.faults_and_remedies()
    assert shown.startswith(fault)
    assert "`starbench ledger --explain TEXT`" in shown
    assert ledger.explain("The disk broke.", "ada") == [fault]
    assert ledger.faults() == []
    (line,) = ledger.explained_runs()
    assert (line.data["what"], line.data["reason"], line.data["by"]) == (fault, "The disk broke.", "ada")
    with pytest.raises(UsageError, match="no break to explain"):
        ledger.explain("The disk broke.", "ada")


def test_an_explained_run_that_comes_back_changed_is_a_fault_again(ledger, lost_run, tmp_path):
    ledger.explain("The disk broke.", "ada")
    (tmp_path / "taken away").rename(lost_run)
    assert ledger.faults() == []
    (lost_run / "SHA256SUMS").write_text("sealed again")
    (fault,) = ledger.faults()
    assert "was changed after sealing" in str(fault)


def test_an_explained_run_stays_explained_if_the_fault_is_told_in_other_words(ledger, lost_run, monkeypatch):
    ledger.explain("The disk broke.", "ada")
    monkeypatch.setattr(RunFault, "__str__", lambda self: "other words")
    assert ledger.faults() == []


def test_a_mark_that_the_disk_does_not_give_is_an_error_of_the_disk_and_no_break(ledger):
    runs(ledger, 1)
    broken = StorageError("The file system reports an error: Input/output error.", where="/home/ledger_high")
    with (
        mock.patch("bench.record.ledger.read_own_mark", side_effect=broken),
        pytest.raises(StorageError, match="/home/ledger_high"),
    ):
        begin(ledger, "next")
    assert faults(ledger) == []
    assert begin(ledger, "next")["number"] == 2

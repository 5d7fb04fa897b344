"""The index of runs: nothing but what the journals say, however old or broken the index itself is."""

import os
import sqlite3
from contextlib import closing
from datetime import UTC, datetime

import pytest
from many_runs import write_run
from refusals import denied

from bench.base.clock import VirtualClock
from bench.base.errors import StorageError, UsageError
from bench.record.coverage import Estimate
from bench.record.events import Event
from bench.record.journal import Journal
from bench.record.run_folder import RunFolder
from bench.record.run_index import RunIndex, run_folders
from bench.solve.agreement import agreement, compare_runs
from tests.support.running import called

DAYS = [datetime(2026, 3, day, 20, 0, tzinfo=UTC) for day in (1, 2, 3)]


def make(path, begun=DAYS[0], *, fx=3345.0, **facts):
    stated = {"serial": "00050423", "simulated": True, "poses": 2, "deviations": ["so"], **facts}
    solved = {"coverage_factors": {"r": 2.4}, "shared": {"fx": 0.3}}
    values = {"fx": fx, "r": 255.0} if fx else None
    return write_run(path, begun=begun, values=values, sigmas={"fx": 0.5, "r": 0.1}, solved=solved, **stated)


@pytest.fixture
def index(tmp_path):
    return RunIndex(tmp_path / "home")


@pytest.fixture
def three(tmp_path):
    return [
        make(tmp_path / "runs" / "c", DAYS[2], serial="00050999"),
        make(tmp_path / "runs" / "a", DAYS[0]),
        make(tmp_path / "runs" / "night" / "b", DAYS[1], ended="failed", fx=None),
    ]


def test_a_row_is_what_the_journal_says(index, three):
    (run,), faults = index.runs(three[1:2])
    assert faults == []
    assert (run.id, run.sequence, run.station, run.camera) == ("a", "Three poses", "Bench 1", "00050423")
    assert (run.how, run.sealed, run.simulated) == ("finished", False, True)
    assert (run.accepted, run.deviations) == (2, 1)
    assert (run.temperature_c, run.model, run.rms_px) == (41.5, "radial", 0.081)
    assert run.parameters == {"fx": (3345.0, 0.5, 2.2, 0.3), "r": (255.0, 0.1, 2.4, 0.0)}
    stated = {"value": 3345.0, "sigma": 0.5, "coverage_factor": 2.2, "expanded": 1.1}
    assert run.to_dict()["parameters"]["fx"] == stated


def test_runs_come_oldest_first_and_as_chosen(index, three):
    def ids(**words):
        return [run.id for run in index.runs(three, **words)[0]]

    assert ids() == ["a", "b", "c"]
    assert ids(camera="00050999") == ["c"]
    assert ids(since=DAYS[1]) == ["b", "c"]
    assert ids(since=DAYS[1], until=DAYS[2]) == ["b"]
    assert ids(sequence="hre") == ["a", "b", "c"]
    assert ids(sequence="four") == []
    assert ids(how="failed") == ["b"]
    assert ids(how="failed", camera="00050999") == []


def test_the_folders_of_runs_are_found_two_deep(tmp_path, three):
    (tmp_path / "runs" / "journal.jsonl").write_text("")  # a batch's
    (tmp_path / "runs" / "queue.yaml").write_text("")
    assert run_folders(tmp_path / "runs") == sorted(three)
    assert run_folders(three[0]) == [three[0]]
    with pytest.raises(StorageError, match="no such folder"):
        run_folders(tmp_path / "none")


def test_a_journal_that_went_on_is_read_again(index, tmp_path):
    path = make(tmp_path / "run", ended=None)
    assert index.runs([path])[0][0].how == "cut off"
    with RunFolder.open(path):
        assert index.runs([path])[0][0].how == "running"
    with Journal.open(path / "journal.jsonl", VirtualClock(DAYS[1])) as journal:
        journal.append(Event.RUN_ENDED, how="aborted", why="")
    assert index.runs([path])[0][0].how == "aborted"


@pytest.mark.parametrize(("kind", "shown"), [("marginal", True), ("pass", False)])
def test_a_list_shows_the_verdict_of_a_run_that_has_reservations(tmp_path, kind, shown):
    path = make(tmp_path / "run", ended=None)
    with Journal.open(path / "journal.jsonl", VirtualClock(DAYS[1])) as journal:
        journal.append(Event.WRITTEN, head="", files={}, verdict={"kind": kind, "headline": "As calibrated."})
        journal.append(Event.RUN_ENDED, how="finished", why="")
    assert ("As calibrated." in called("runs", path, home=tmp_path / "home").stdout) == shown


def test_the_name_of_a_run_folder_writes_no_row_of_its_own(tmp_path):
    run = make(tmp_path / "runs" / "a\n2026-03-01 20:00  00050423   finished")
    listed = called("runs", run.parent, home=tmp_path / "home").stdout
    assert r"runs/a\n2026-03-01 20:00  00050423   finished" in listed
    assert len(listed.splitlines()) == 2


def test_an_unchanged_journal_is_not_read_again(index, three, monkeypatch):
    index.runs(three)
    monkeypatch.setattr("bench.record.stored_run.read_journal", lambda _: pytest.fail("it was read again"))
    assert len(index.runs(three)[0]) == 3


def test_a_seal_that_is_added_is_seen_although_the_journal_is_as_before(index, three):
    assert not any(run.sealed for run in index.runs(three)[0])
    (three[1] / "SHA256SUMS.sig").write_text("signature")
    assert [run.id for run in index.runs(three)[0] if run.sealed] == ["a"]


def test_a_run_is_listed_once_also_where_a_link_leads_to_it(index, tmp_path, three):
    link = tmp_path / "runs" / "link"
    link.symlink_to(three[0], target_is_directory=True)
    (tmp_path / "other").symlink_to(tmp_path / "runs", target_is_directory=True)
    runs, faults = index.runs([*three, link, tmp_path / "other" / "a", three[1] / ".." / "a"])
    assert faults == []
    assert [run.folder for run in runs] == [str(three[at].resolve()) for at in (1, 2, 0)]


@pytest.mark.parametrize("harm", ["garbage", "older", "deleted"])
def test_an_index_that_does_not_hold_is_made_anew(index, three, harm):
    before = index.runs(three)
    if harm == "older":
        with closing(sqlite3.connect(index.path)) as database, database:
            database.execute("ALTER TABLE runs DROP COLUMN found")
            database.execute("PRAGMA user_version = 0")
    else:
        for path in index.path.parent.iterdir():
            path.unlink()
        if harm == "garbage":
            index.path.write_bytes(b"this is no database" * 100)
    assert index.runs(three) == before


def test_details_are_those_of_the_journal_also_where_the_index_was_deleted_since(index, three):
    runs, _ = index.runs(three)
    kept = list(index.details(runs))
    index.path.unlink()
    assert list(index.details(runs)) == kept
    assert [details["deviations"] for _, details in kept] == [["so"]] * 3


def test_a_broken_journal_is_named_and_the_others_are_listed(index, three):
    journal = three[0] / "journal.jsonl"
    journal.write_bytes(journal.read_bytes().replace(b"Three", b"Seven"))
    runs, faults = index.runs(three)
    assert [run.id for run in runs] == ["a", "b"]
    assert len(faults) == 1
    assert str(journal) in faults[0]


def test_a_folder_that_may_not_be_read_is_not_called_empty(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "scandir", denied)
    with pytest.raises(StorageError, match="No permission"):
        run_folders(tmp_path)


def test_an_index_on_a_full_disk_asks_for_room_and_not_to_be_deleted(index, three, monkeypatch):
    error = sqlite3.OperationalError("database or disk is full")
    error.sqlite_errorcode = sqlite3.SQLITE_FULL
    index.runs(three)

    def full(*_, **__):
        raise error

    monkeypatch.setattr(sqlite3, "connect", full)
    with pytest.raises(StorageError, match="Make room") as refused:
        index.runs(three)
    assert "Delete it" not in str(refused.value)


def test_an_index_that_cannot_be_made_is_not_to_be_deleted(index):
    index.path.parent.mkdir(exist_ok=True)
    index.path.symlink_to(index.path.parent / "nowhere" / "index")
    with pytest.raises(StorageError, match="mode or owner"):
        index.runs([])


# ---------------------------------------------------------------- comparing


def test_the_better_known_value_weighs_more_and_runs_that_scatter_as_they_say_have_a_birge_ratio_near_one():
    agreed = agreement("fx", [Estimate(100.0 + d, 1.0) for d in (-1.0, 1.0, -1.0, 1.0)])
    assert (agreed["mean"], agreed["sigma"]) == (100.0, 0.5)
    assert agreed["birge"] == pytest.approx((4 / 3) ** 0.5)
    assert agreed["deviations"][0] == pytest.approx(-1 / 0.75**0.5)
    agreed = agreement("r", [Estimate(255.0, 0.1), Estimate(256.0, 1.0)])
    assert agreed["mean"] == pytest.approx(255.0 + 1 / 101)
    assert agreed["deviations"] == pytest.approx([-1 / 1.01**0.5, 1 / 1.01**0.5])


def test_only_runs_of_one_camera_and_one_model_are_compared(index, tmp_path, three):
    others = {
        "d": {"fx": 3346.0},
        "e": {"model": "planar"},
        "f": {"simulated": False},
        "g": {"rehearsal": True},
    }
    folders = [make(tmp_path / "runs" / name, DAYS[2], **facts) for name, facts in others.items()]
    runs = {run.id: run for run in index.runs([*three, *folders])[0]}
    assert [a["name"] for a in compare_runs([runs["a"], runs["d"]])] == ["fx", "r"]
    for other, why in (
        ("c", "different cameras: 00050423, 00050999"),
        ("e", "different models: planar, radial"),
        ("f", "different kinds: measured, simulated"),
        ("g", "different kinds: rehearsed, simulated"),
    ):
        with pytest.raises(UsageError, match=why):
            compare_runs([runs["a"], runs[other]])
    with pytest.raises(UsageError, match="at least two"):
        compare_runs([runs["a"]])


def test_an_index_that_another_process_has_locked_is_left_alone(index, three, monkeypatch):
    index.runs(three)
    with closing(sqlite3.connect(index.path)) as other:
        other.execute("BEGIN EXCLUSIVE")
        connect = sqlite3.connect
        monkeypatch.setattr(sqlite3, "connect", lambda path, **_: connect(path, timeout=0.0))
        monkeypatch.setattr("bench.record.run_index.VERSION", 99)  # it wants to write at once
        with pytest.raises(StorageError, match="locked"):
            index.runs(three)
        other.rollback()
        monkeypatch.undo()
        assert other.execute("SELECT count(*) FROM runs").fetchone() == (3,)
    assert len(index.runs(three)[0]) == 3

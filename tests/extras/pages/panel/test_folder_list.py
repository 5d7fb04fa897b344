"""The list of runs and batches in a folder, also one with folders that cannot be read."""

import json
import os
from pathlib import Path

import pytest
from journals import MadeRun, made_batch

from bench.base.errors import RunFolderError
from bench.batch.batch_status import batch_status_text, read_batch_status
from bench.extras.pages.panel.folder_list import FolderList


def _look(root):
    listing = FolderList(root).look()
    json.dumps(listing, allow_nan=False)
    return listing


def test_runs_of_all_kinds_newest_first(tmp_path, monkeypatch):
    MadeRun(tmp_path / "a").begin().record_all().end()
    MadeRun(tmp_path / "b").begin().end("failed", "the lamp is broken")
    MadeRun(tmp_path / "deeper" / "c").begin()
    (tmp_path / "notes.txt").write_text("nothing")
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path)
    listing = _look(Path())
    assert listing["root"] == str(tmp_path)
    rows = {row["key"]: row for row in listing["runs"]}
    verdicts = {"a": "not sealed", "b": "failed", "deeper/c": "interrupted"}
    assert {key: row["verdict"] for key, row in rows.items()} == verdicts
    assert rows["b"]["why"] == "the lamp is broken"
    assert rows["a"]["accepted"] == 3
    assert rows["a"]["camera"] == "42"
    assert listing["faults"] == []


def test_a_damaged_run_is_listed_with_its_fault(tmp_path):
    run = MadeRun(tmp_path / "a").begin()
    run.path.write_bytes(run.path.read_bytes().replace(b'"homing"', b'"x"').replace(b'"EVK4"', b'"EVK5"'))
    row = _look(tmp_path)["runs"][0]
    assert "its hash" in row["fault"]
    assert row["verdict"] == "not readable"


def test_a_batch_is_one_entry_and_its_runs_belong_to_its_page(tmp_path):
    batch = made_batch(tmp_path / "night")
    MadeRun(batch.folder / "runs" / "cam-001").begin()
    listing = _look(tmp_path)
    assert listing["runs"] == []
    (row,) = listing["batches"]
    assert (row["key"], row["queue"], row["coming"], row["ended_utc"]) == ("night", "Night", 1, "")


@pytest.fixture
def begun(tmp_path):
    """A batch whose only run has begun, and the name of the run."""
    batch = made_batch(tmp_path / "night")
    (name,) = (run.item for run in read_batch_status(batch.folder).upcoming)
    batch.write("item_begun", item=name, again=False, attempt=1, recorded=0)
    return batch, name


def test_a_batch_that_has_ended_says_when_its_last_run_did(tmp_path, begun):
    batch, name = begun
    batch.write("item_ended", item=name, how="finished", why="", noticed_s=0.0, unsafe=[])
    assert _look(tmp_path)["batches"][0]["ended_utc"] == ""
    last = read_batch_status(batch.folder).last_end
    batch.write("batch_ended", how="finished", why="")
    assert _look(tmp_path)["batches"][0]["ended_utc"] == last.isoformat()


@pytest.mark.parametrize("simulated", [True, False])
def test_a_batch_with_a_simulated_run_is_marked(tmp_path, begun, simulated):
    batch, name = begun
    plan = MadeRun(batch.folder / "runs" / name).folder / "plan.json"
    plan.write_text(json.dumps({**json.loads(plan.read_text()), "simulated": simulated}))
    assert _look(tmp_path)["batches"][0]["simulated"] is simulated
    assert ("SIMULATED" in batch_status_text(read_batch_status(batch.folder))) is simulated


def test_a_damaged_batch_does_not_hide_the_runs(tmp_path):
    MadeRun(tmp_path / "a").begin()
    broken = MadeRun(tmp_path / "night")
    (broken.folder / "queue.yaml").write_text("nonsense: [")
    listing = _look(tmp_path)
    assert [row["key"] for row in listing["runs"]] == ["a"]
    assert "queue.yaml" in listing["faults"][0]


def test_a_folder_that_refuses_is_named(tmp_path, monkeypatch):
    (tmp_path / "secret").mkdir()
    MadeRun(tmp_path / "a").begin()
    real = os.scandir

    def scandir(path):
        if str(path).endswith("secret"):
            raise PermissionError(13, "Permission denied", str(path))
        return real(path)

    monkeypatch.setattr(os, "scandir", scandir)
    listing = _look(tmp_path)
    assert "No permission" in listing["faults"][0]
    assert "secret" in listing["faults"][0]
    assert len(listing["runs"]) == 1


@pytest.mark.parametrize(
    "key", ["", "..", "../a", "a/../..", "/etc", "a//b", "nowhere", "a\0b", "C:x", "a\\b"]
)
def test_no_key_leads_out_of_the_folder(tmp_path, key):
    root = tmp_path / "runs"
    MadeRun(root / "a").begin()
    MadeRun(tmp_path / "outside").begin()
    with pytest.raises(RunFolderError, match="no run or batch"):
        FolderList(root).folder_of(key)


def test_of_very_many_runs_some_are_read_at_each_look_until_all_are_listed(tmp_path, monkeypatch):
    monkeypatch.setattr("bench.extras.pages.panel.folder_list.MOST_NEW", 2)
    for name in "abcde":
        MadeRun(tmp_path / name).begin().end()
    listed = FolderList(tmp_path)
    looks = [listed.look() for _ in range(3)]
    assert [(len(listing["runs"]), listing["unread"]) for listing in looks] == [(2, 3), (4, 1), (5, 0)]


def test_a_run_that_another_replaces_in_its_folder_is_read_again(tmp_path):
    old = MadeRun(tmp_path / "a").begin().end()
    new = MadeRun(tmp_path / "away" / "b").begin().end("failed", "so")
    listed = FolderList(tmp_path)
    assert {row["key"]: row["how"] if "how" in row else row["verdict"] for row in listed.look()["runs"]}["a"]
    times = old.path.stat()
    new.path.write_bytes(new.path.read_bytes())
    os.utime(new.path, ns=(times.st_atime_ns, times.st_mtime_ns))
    new.path.rename(old.path)
    row = next(row for row in listed.look()["runs"] if row["key"] == "a")
    assert row["why"] == "so"

"""History of a run: found at once however long; lines that last; entries that somebody replaced."""

import os
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import pytest
from journals import CLOCK

from bench.base.clock import BenchClock
from bench.base.errors import JournalBroken
from bench.record.events import AttemptChecked, CaptureStored, Entering, Event, LeftOff, RunEnded, StepDone
from bench.record.history import replay
from bench.record.journal import Journal
from bench.record.measured_facts import GateData
from bench.record.run_log import RunLog

ATTEMPTS = [(2, 1, False), (1, 1, True), (2, 2, True), (1, 2, True), (3, 1, None)]


def test_recordings_are_found_by_their_pose_and_the_last_accepted_counts(tmp_path):
    with Journal.create(tmp_path / "j", CLOCK) as journal:
        for pose, attempt, accepted in ATTEMPTS:
            which = {"pose": pose, "attempt": attempt}
            name = f"{pose}-{attempt}"
            journal.append(Event.CAPTURE_STORED, pose_name=f"p{pose}", capture=name, **which)
            if accepted is not None:
                journal.append(Event.ATTEMPT_CHECKED, accepted=accepted, **which)
        history = replay(journal.entries)
        journal.append(Event.ATTEMPT_CHECKED, pose=1, attempt=3, accepted=True)
        with pytest.raises(JournalBroken, match="pose 1, attempt 3"):  # it was never stored
            replay(journal.entries)
    assert {p: a.stored["capture"] for p, a in history.accepted().items()} == {1: "1-2", 2: "2-2"}
    assert [a.accepted for a in history.attempts_at(2)] == [False, True]
    assert (history.unchecked(3), history.unchecked(2)) == (history.attempts[-1], None)
    assert [history.next_attempt(pose) for pose in (1, 2, 3, 4)] == [3, 3, 2, 1]


def test_time_counts_for_the_step_at_work_without_holds_and_without_the_time_between_processes(tmp_path):
    now = {"s": 0.0}
    begin = datetime(2026, 3, 1, tzinfo=UTC)
    clock = SimpleNamespace(utc_now=lambda: begin + timedelta(seconds=now["s"]), monotonic=lambda: now["s"])
    with Journal.create(tmp_path / "j", clock) as journal:
        for after_s, event, data in (
            (1.0, Event.ENTERING, {"state": "preflight", "from": "idle"}),
            (2.0, Event.ENTERING, {"state": "slewing", "from": "preflight", "step": 7}),
            (3.0, Event.LEFT_OFF, {"state": "slewing"}),
            (3.5, Event.ENTERING, {"state": "holding", "from": "slewing", "step": 8}),
            (60.0, Event.ENTERING, {"state": "settling", "from": "holding", "step": 8}),
            (62.0, Event.LEFT_OFF, {"state": "settling"}),
        ):
            now["s"] = after_s
            journal.append(event, **data)
        now["s"] = 5000.0
        journal.append(Event.RUN_RESUMED, torn_bytes=0, software={})
        journal.append(Event.ENTERING, state="settling", **{"from": "idle"}, step=8)
        now["s"] = 5001.0
        journal.append(Event.STEP_DONE, step=8)
        history = replay(journal.entries)
    assert history.worked_s == {7: 1.5, 8: 3.0}


def test_decisions_give_the_chosen_poses_and_what_is_left_out(tmp_path):
    with Journal.create(tmp_path / "j", CLOCK) as journal:
        head = {"until": 2, "until_last": 30}
        chosen = {"pose": 4, "pose_name": "chosen 1", "angles_deg": {"pan": 1.5}, "expected": {}, "why": ""}
        journal.append(Event.UNTIL_DECIDED, step=11, chosen=chosen, **head)
        before = replay(journal.entries)
        journal.append(Event.UNTIL_DECIDED, step=15, ended="met", why="", **head)
        after = replay(journal.entries)
    assert before.chosen == after.chosen == {4: {"pan": 1.5}}
    assert not any(before.is_left_out(step) for step in range(40))
    assert [step for step in range(40) if after.is_left_out(step)] == list(range(16, 31))


# ---------------------------------------------------------------- what a cut of power may take

POSE = {"pose": 1, "pose_name": "p"}

STORED = {**POSE, "attempt": 1, "capture": "c", "size": 1, "sha256": "0"}

LAST = [
    *((Entering, {"state": state, **POSE}) for state in ("homing", "recording")),
    (CaptureStored, STORED),
    (LeftOff, {"state": "slewing", "error": "stalled"}),
    (RunEnded, {"how": "finished", "why": ""}),
]

ON_THE_WAY = [
    (Entering, {"state": "settling", **POSE}),
    (LeftOff, {"state": "slewing"}),
    (StepDone, {"step": 3}),
    (AttemptChecked, {"pose": 1, "attempt": 1, "accepted": True, "reasons": []}),
]


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "journal.jsonl"
    with Journal.create(path, BenchClock()) as journal:
        log = RunLog(journal)
        with pytest.raises(ValueError, match="gate_data"):
            log.write(GateData)
        log.write(CaptureStored, **STORED)
        yield log


def syncs(log, monkeypatch, payload, data):
    synced = []
    monkeypatch.setattr(os, "fsync", synced.append)
    log.write(payload, **data)
    return len(synced)


@pytest.mark.parametrize(
    ("payload", "data"), LAST, ids=lambda x: x.__name__ if isinstance(x, type) else x.get("state", "")
)
def test_what_counts_lasts_when_it_is_told(log, monkeypatch, payload, data):
    assert syncs(log, monkeypatch, payload, data) == 1


@pytest.mark.parametrize(
    ("payload", "data"), ON_THE_WAY, ids=lambda x: x.__name__ if isinstance(x, type) else x.get("state", "")
)
def test_what_only_tells_of_the_way_lasts_with_the_next_line(log, monkeypatch, payload, data):
    assert syncs(log, monkeypatch, payload, data) == 0
    assert syncs(log, monkeypatch, Entering, {"state": "slewing", **POSE}) == 1

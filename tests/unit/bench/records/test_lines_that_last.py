"""Which lines of a run last by themselves, and which with the next: what a cut of power may take is found out again."""

import os
from datetime import UTC, datetime

import pytest

from bench.records.events import Event
from bench.records.history import RunLog
from bench.records.journal import Journal

POSE = {"pose": 1, "pose_name": "p"}
STORED = {**POSE, "attempt": 1, "capture": "c", "size": 1, "sha256": "0"}
LAST = [
    (Event.RUN_STARTED, {"id": "r"}),
    (Event.DEVICES, {"camera": {}}),
    *((Event.ENTERING, {"state": s, **POSE}) for s in ("homing", "lighting", "slewing", "recording", "holding", "parking")),
    (Event.CAPTURE_STORED, STORED),
    (Event.LEFT_OFF, {"state": "slewing", "error": "stalled"}),
    (Event.DEVIATION, {"what": "so"}),
    (Event.POSE_SKIPPED, {**POSE, "what": "so"}),
    (Event.SOLVED, {"model": "spherical"}),
    (Event.RUN_ENDED, {"how": "finished", "why": ""}),
]  # fmt: skip
ON_THE_WAY = [
    *((Event.ENTERING, {"state": state, **POSE}) for state in ("settling", "checking")),
    (Event.LEFT_OFF, {"state": "slewing"}),
    (Event.STEP_DONE, {"step": 3}),
    (Event.ATTEMPT_CHECKED, {"pose": 1, "attempt": 1, "accepted": True, "reasons": []}),
]


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "journal.jsonl"
    with Journal.create(path, utc_now=lambda: datetime.now(UTC), monotonic=lambda: 0.0) as journal:
        log = RunLog(journal)
        log.write(Event.CAPTURE_STORED, **STORED)
        yield log


def syncs(log, monkeypatch, event, data):
    synced = []
    monkeypatch.setattr(os, "fsync", synced.append)
    log.write(event, **data)
    return len(synced)


@pytest.mark.parametrize(
    ("event", "data"), LAST, ids=lambda x: x if isinstance(x, str) else x.get("state", "")
)
def test_what_counts_lasts_when_it_is_told(log, monkeypatch, event, data):
    assert syncs(log, monkeypatch, event, data) == 1


@pytest.mark.parametrize(
    ("event", "data"), ON_THE_WAY, ids=lambda x: x if isinstance(x, str) else x.get("state", "")
)
def test_what_only_tells_of_the_way_lasts_with_the_next_line(log, monkeypatch, event, data):
    assert syncs(log, monkeypatch, event, data) == 0
    assert syncs(log, monkeypatch, Event.ENTERING, {"state": "slewing", **POSE}) == 1

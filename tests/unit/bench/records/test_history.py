"""History of a run: entries of the journal are found at once, however long the run."""

from datetime import UTC, datetime

import pytest

from bench.base.errors import JournalBroken
from bench.records.events import Event
from bench.records.history import Attempt, History, replay
from bench.records.journal import Journal

CLOCKS = {"utc_now": lambda: datetime(2026, 3, 1, tzinfo=UTC), "monotonic": lambda: 0.0}


def test_recordings_are_found_by_their_pose_and_the_last_accepted_counts(tmp_path):
    with Journal.create(tmp_path / "j", **CLOCKS) as journal:
        for pose, attempt, accepted in (
            (2, 1, False),
            (1, 1, True),
            (2, 2, True),
            (1, 2, True),
            (3, 1, None),
        ):
            journal.append_unsynced(
                Event.CAPTURE_STORED,
                pose=pose,
                pose_name=f"p{pose}",
                attempt=attempt,
                capture=f"{pose}-{attempt}",
            )
            if accepted is not None:
                journal.append_unsynced(Event.ATTEMPT_CHECKED, pose=pose, attempt=attempt, accepted=accepted)
        history = replay(journal.entries)
    assert {p: a.stored["capture"] for p, a in history.accepted().items()} == {1: "1-2", 2: "2-2"}
    assert [a.accepted for a in history.attempts_at(2)] == [False, True]
    assert (history.unchecked(3), history.unchecked(2)) == (history.attempts[-1], None)
    assert [history.next_attempt(pose) for pose in (1, 2, 3, 4)] == [3, 3, 2, 1]


def test_a_recording_that_was_never_stored_cannot_be_checked(tmp_path):
    with Journal.create(tmp_path / "j", **CLOCKS) as journal:
        journal.append_unsynced(Event.CAPTURE_STORED, pose=1, pose_name="p", attempt=1)
        journal.append_unsynced(Event.ATTEMPT_CHECKED, pose=1, attempt=2, accepted=True)
        with pytest.raises(JournalBroken, match="pose 1, attempt 2"):
            replay(journal.entries)


def test_a_history_created_with_attempts_holds_them():
    one = Attempt(4, "p", 1, {}, {"accepted": True})
    assert dict(History(attempts=[one]).accepted()) == {4: one}

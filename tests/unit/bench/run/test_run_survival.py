"""A run survives any change of the clock, and a light that goes dark."""

from datetime import timedelta

import pytest
from rehearsed import Scene

from bench.base.clock import VirtualClock
from bench.evidence.findings import Verification
from bench.evidence.journal_check import check_journal
from bench.record.events import Event
from bench.record.journal import CLOCK_JUMPED, read_journal
from bench.run.status import event_text


def accepted(scene):
    return sorted(d["pose"] for d in scene.data_of(Event.ATTEMPT_CHECKED) if d["accepted"])


# ---------------------------------------------------------------- the system's time is set in the midst


@pytest.mark.parametrize("hours", [-5, 5])
def test_a_changed_system_clock_is_reported_and_changes_nothing_else(tmp_path, monkeypatch, hours):
    scene = Scene(tmp_path)
    utc_now = VirtualClock.utc_now
    set_by = [timedelta()]
    monkeypatch.setattr(VirtualClock, "utc_now", lambda clock: utc_now(clock) + set_by[-1])

    scene.at("camera.record", 1, lambda: set_by.append(timedelta(hours=hours)))
    assert scene.run().how == "finished"
    (jump,) = scene.data_of(CLOCK_JUMPED)
    assert jump["jump_s"] == pytest.approx(3600 * hours, abs=2)
    assert accepted(scene) == [1, 2]
    entries, _ = read_journal(scene.folder / "journal.jsonl")
    assert [text for text in map(event_text, entries) if f"clock jumped by {hours * 3600}" in text]
    check_journal(scene.folder, {}, found := Verification())
    assert f"clock jumped by {hours * 3600}" in str(found.remarks)
    assert [e.mono_s for e in entries] == sorted(e.mono_s for e in entries)
    assert entries[-1].mono_s - entries[0].mono_s < 60


@pytest.mark.parametrize(("asleep_s", "attempts"), [(0.1, 2), (1800.0, 3)])
def test_a_recording_in_which_the_computer_was_suspended_is_made_again(
    tmp_path, monkeypatch, asleep_s, attempts
):
    """CLOCK_MONOTONIC stands still while a computer is suspended: nothing else notices the gap."""
    scene = Scene(tmp_path)
    slept_s = []
    monkeypatch.setattr(VirtualClock, "asleep_s", lambda _clock: sum(slept_s))
    scene.at("camera.record", 1, lambda: slept_s.append(asleep_s))
    assert scene.run().how == "finished"
    checked = scene.data_of(Event.ATTEMPT_CHECKED)
    assert len(checked) == attempts
    assert accepted(scene) == [1, 2]
    reasons = [reason for attempt in checked for reason in attempt["reasons"]]
    suspended = ["the computer was suspended for 1800 s during the recording"]
    assert reasons == (suspended if attempts == 3 else [])

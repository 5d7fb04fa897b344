"""Recordings against the journal of their run, without their events: heads, sizes, and what follows the last event."""

import hashlib
from datetime import UTC, datetime

import numpy as np
import pytest

from bench.record.journal import Journal
from bench.solve.recorded_with import check_recorded_with

HEAD = (
    "% date 2026-03-01 13:02:05\n% evt 3.0\n% format EVT3;height=720;width=1280\n% geometry 1280x720\n"
    "% serial_number 00051234\n% end\n"
)
EVENTS = np.tile(np.array([0x8001, 0x6002, 0x0005, 0x2803], "<u2"), 50).tobytes()
TIMES = np.tile(np.array([0x8002, 0x6003], "<u2"), 500).tobytes()
WHOLE = HEAD.encode() + EVENTS + TIMES
NAME = "captures/pose-001-attempt-1.raw"


@pytest.fixture
def checked(tmp_path):
    """Checks a run with one recording; the journal is written for the bytes that the camera had written."""

    def check(data=WHOLE, *, written=None, serial="00051234"):
        (tmp_path / "captures").mkdir()
        (tmp_path / NAME).write_bytes(data)
        clocks = {"utc_now": lambda: datetime(2026, 3, 1, 12, 2, 6, tzinfo=UTC), "monotonic": lambda: 1.0}
        facts = {"serial": serial, "width": 1280, "height": 720, "bytes": len(written or data)}
        with Journal.create(tmp_path / "journal.jsonl", **clocks) as journal:
            journal.append("run_started", id="run-1")
            journal.append("devices", camera={"serial": "00051234", "width": 1280, "height": 720})
            journal.append(
                "capture_stored",
                capture=NAME,
                size=len(data),
                sha256=hashlib.sha256(data).hexdigest(),
                pose=1,
                pose_name="left",
                attempt=1,
                facts=facts,
            )
        return check_recorded_with(tmp_path)

    return check


def test_what_a_camera_writes_is_confirmed_with_times_behind_its_last_event(checked):
    check = checked()
    assert (check.faults, check.remarks) == ([], [])


@pytest.mark.parametrize(
    "more", [b"\0" * 1_000_000, b"fx=3999;" * 1000, np.arange(5000, dtype="<u2").tobytes()]
)
def test_bytes_behind_the_last_event_are_found(checked, more):
    size, *_ = [fault.what for fault in checked(WHOLE + more, written=WHOLE).faults]
    assert size.startswith(f"it has {len(WHOLE + more)} bytes; the camera had written {len(WHOLE)}")


def test_they_are_found_though_the_journal_states_the_size(checked):
    (fault,) = checked(HEAD.encode() + EVENTS + b"\0" * 1_000_000).faults
    assert (fault.kind, fault.where) == ("recording", NAME)
    assert fault.what == "500000 words follow its last event that hold neither an event nor a time"


def test_a_few_words_of_an_end_that_was_cut_off_are_none(checked):
    assert checked(HEAD.encode() + EVENTS + b"\x05\x00" * 5).faults == []


@pytest.mark.parametrize("kind", [0x6, 0x8, 0xE, 0xF])
def test_times_and_what_the_camera_says_of_itself_may_follow_the_last_event(checked, kind):
    words = np.full(100, kind << 12 | 5, "<u2").tobytes()
    assert checked(HEAD.encode() + EVENTS + words).faults == []


def test_another_camera_or_size_in_the_head_is_found(checked):
    check = checked((HEAD.replace("00051234", "00050999")).encode() + EVENTS)
    assert "its head names the serial 00050999" in check.faults[0].what


def test_another_camera_in_the_facts_is_found(checked):
    assert "recorded with a camera whose serial is 00050999" in checked(serial="00050999").faults[0].what


def test_another_date_in_the_head_is_told(checked):
    (remark,) = checked((HEAD.replace("2026-03-01", "1999-01-01")).encode() + EVENTS).remarks
    assert "its head states the time 1999-01-01 13:02:05, the journal 2026-03-01 12:02 UTC" in remark


@pytest.mark.parametrize(("date", "remarks"), [("2026-03-02 02:02:05", 0), ("2026-03-02 03:32:05", 1)])
def test_a_date_that_a_time_zone_explains_is_not_told(checked, date, remarks):
    """Local time differs from UTC by 14 h at most. The journal says 12:02:06 UTC."""
    head = HEAD.replace("2026-03-01 13:02:05", date)
    assert len(checked(head.encode() + EVENTS).remarks) == remarks


def test_what_no_camera_writes_into_the_head_is_told(checked):
    (remark,) = checked((HEAD.replace("% end", "% comment fx=3999\n% end")).encode() + EVENTS).remarks
    assert remark.endswith("its head states what nothing compares: comment fx=3999")

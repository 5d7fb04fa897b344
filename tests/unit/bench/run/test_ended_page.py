"""A run that failed or was aborted has a page: why, what to do, what was recorded; signed, and gone when it goes on."""

import base64
import re
from datetime import UTC, datetime

import cv2
import numpy as np
import pytest
from virtual_camera import QUARTER, VirtualCamera

from bench.base.clock import VirtualClock
from bench.base.errors import EvidenceError
from bench.evidence.keys import create_key
from bench.evidence.signers import read_signers
from bench.evidence.verify import verify_folder
from bench.record.events import Event
from bench.record.journal import Journal
from bench.record.run_folder import JOURNAL, PAGE_SIGNATURE, REPORT, RunFolder
from bench.run.ended_page import remove_ended_page, write_ended_page
from bench.wording.numbers import NOTHING
from calib.target import StarTarget
from tests.unit.bench.report.structure import cells

NOW = datetime(2026, 3, 1, 20, 0, tzinfo=UTC)
ERROR = {
    "kind": "PoseFailed",
    "what": "Pose 1 <left> failed.",
    "where": "captures/a.raw",
    "remedy": "Check the lamp.",
}


def tell(journal, attempt, pose=1, accepted=None, reasons=(), **facts):
    """Journal a recording, and what came of its check."""
    which = {"pose": pose, "attempt": attempt}
    named = {"pose_name": "left" if pose == 1 else f"p{pose}", "capture": f"captures/{pose}-{attempt}.raw"}
    journal.append(Event.CAPTURE_STORED, **which, **named, facts=facts)
    if accepted is not None:
        checked = {"accepted": accepted, "stars": 193 * accepted, "reasons": list(reasons)}
        journal.append(Event.ATTEMPT_CHECKED, **which, **checked, gates=[], measured={})


def reopened(folder):
    return Journal.open(folder.journal_path, VirtualClock(NOW))


@pytest.fixture
def key(tmp_path):
    return create_key(tmp_path / "home")


@pytest.fixture
def folder(tmp_path):
    with (
        RunFolder.create(tmp_path / "run") as folder,
        Journal.create(folder.journal_path, VirtualClock(NOW)) as journal,
    ):
        journal.append(Event.RUN_STARTED, id="run-7", simulated=True, sequence="Three", station="Bench")
        reasons = ["The picture is dark.", "stars 0, needed >= 40"]
        tell(journal, 1, accepted=False, reasons=reasons, events=49893)
        journal.append(Event.RUN_ENDED, how="failed", why="dark", error=ERROR, devices=[])
        yield folder


def test_the_page_says_why_what_to_do_and_what_was_recorded(folder, key):
    write_ended_page(folder, lambda: key, pytest.fail, StarTarget())
    page = (folder.path / REPORT).read_text()
    for fact in (
        "The run failed.", "Pose 1 &lt;left&gt; failed. (captures/a.raw)", "Check the lamp.", "stars 0, needed &gt;= 40",
        f"starbench resume {folder.path}", "0 of 1 recordings accepted", "SIMULATED",
    ):  # fmt: skip
        assert fact in page


def test_beside_the_refused_picture_stands_the_last_good_one_with_its_stars(folder, key, monkeypatch):
    lit = VirtualCamera({"camera": QUARTER}, 1).picture({})
    with reopened(folder) as journal:
        tell(journal, 1, pose=2, accepted=True)
        tell(journal, 1, pose=3, accepted=False)
        journal.append(Event.RUN_ENDED, how="failed", why="dark", error=ERROR, devices=[])
    monkeypatch.setattr("bench.measure.measure.recorded_image", lambda path: lit * (path.name == "2-1.raw"))
    write_ended_page(folder, lambda: key, pytest.fail, StarTarget())
    shown = re.findall(r'base64,([^"]+)" alt="([^"]+)"', (folder.path / REPORT).read_text())
    refused, good = (cv2.imdecode(np.frombuffer(base64.b64decode(png), np.uint8), -1) for png, _ in shown)
    assert refused.max() == 0
    assert "p2" in shown[1][1]
    assert np.count_nonzero(np.ptp(good, axis=2)) > 1000  # the rings alone have a colour


def test_each_recording_shows_whether_it_was_accepted(folder, key):
    with reopened(folder) as journal:
        tell(journal, 2, accepted=True, events=1234567)
        tell(journal, 3, events=1234567)
    write_ended_page(folder, lambda: key, pytest.fail, StarTarget())
    why = "The picture is dark; stars 0, needed >= 40"
    assert cells((folder.path / REPORT).read_text(), "Recordings") == [
        ["left", "1", "[fail] refused", "0", "49\u202f893", why, "captures/1-1.raw"],
        ["left", "2", "[pass] accepted", "193", "1\u202f234\u202f567", NOTHING, "captures/1-2.raw"],
        ["left", "3", "[marginal] not measured", NOTHING, "1\u202f234\u202f567", NOTHING, "captures/1-3.raw"],
    ]


def test_a_run_whose_journal_says_that_it_finished_keeps_its_report(folder, key):
    """Only the sync of that line had failed: the run ended as a failed one, and is sealed when it is resumed."""
    with reopened(folder) as journal:
        journal.append(Event.RUN_RESUMED, torn_bytes=0, software={})
        journal.append(Event.RUN_ENDED, how="finished", why="", devices=[])
    (folder.path / REPORT).write_text("the report")
    write_ended_page(folder, lambda: key, pytest.fail, StarTarget())
    assert (folder.path / REPORT).read_text() == "the report"
    assert not (folder.path / PAGE_SIGNATURE).exists()


def verified(folder, tmp_path):
    verification = verify_folder(folder.path, read_signers(tmp_path / "home" / "allowed_signers"), now=NOW)
    assert not verification.ok
    assert ("unsealed", "SHA256SUMS") in {(fault.kind, fault.where) for fault in verification.faults}
    return {(fault.kind, fault.where) for fault in verification.faults[1:]}, verification.statements


def test_verify_says_that_the_bench_signed_the_page(folder, key, tmp_path):
    write_ended_page(folder, lambda: key, pytest.fail, StarTarget())
    faults, statements = verified(folder, tmp_path)
    assert faults == set()
    assert statements[0].startswith("report.html ")
    assert key.fingerprint in statements[0]


def test_verify_finds_a_changed_page_a_foreign_key_and_another_journal(folder, key, tmp_path):
    write_ended_page(folder, lambda: key, pytest.fail, StarTarget())
    page = (folder.path / REPORT).read_bytes()
    (folder.path / REPORT).write_bytes(page.replace(b"0 of 1", b"1 of 1"))
    assert verified(folder, tmp_path) == ({("signature", PAGE_SIGNATURE)}, [])
    write_ended_page(folder, lambda: create_key(tmp_path / "other"), pytest.fail, StarTarget())
    assert verified(folder, tmp_path) == ({("key", PAGE_SIGNATURE)}, [])
    write_ended_page(folder, lambda: key, pytest.fail, StarTarget())
    lines = (folder.path / JOURNAL).read_bytes().splitlines(keepends=True)
    (folder.path / JOURNAL).write_bytes(b"".join(lines[:-1]))
    assert verified(folder, tmp_path) == ({("journal", JOURNAL)}, [])
    (folder.path / JOURNAL).write_bytes(b"".join(lines).replace(b"49893", b"49894"))
    assert verified(folder, tmp_path) == ({("journal", JOURNAL)}, [])


def test_a_run_that_goes_on_has_no_page_of_its_earlier_end(folder, key):
    write_ended_page(folder, lambda: key, pytest.fail, StarTarget())
    remove_ended_page(folder)
    assert not (folder.path / REPORT).exists()
    assert not (folder.path / PAGE_SIGNATURE).exists()
    folder.write_atomic(REPORT, b"of the results")
    remove_ended_page(folder)
    assert (folder.path / REPORT).read_bytes() == b"of the results"


def test_a_page_that_cannot_be_signed_is_said(folder):
    def no_key():
        raise EvidenceError("The key expired.")

    lines = []
    write_ended_page(folder, no_key, lines.append, StarTarget())
    (line,) = lines
    assert line.endswith("The key expired.")

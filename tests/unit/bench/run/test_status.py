"""Status of a run, read from its folder alone; its last picture; commands at the last moment."""

import functools
import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import numpy as np
import pytest
from locking_process import locking, suspend
from rehearsed import Scene, with_runner

from bench.base.errors import RunFolderError
from bench.base.progress import Reply
from bench.measure.measure import Measurement, StoredImage
from bench.plan.plan import load_documents, make_plan
from bench.record.events import Commanded, Event
from bench.record.journal import Journal
from bench.record.run_folder import RunFolder
from bench.run.control import Command, inbox_of, send
from bench.run.heartbeat import CONTROL
from bench.run.last_view import LAST_VIEW, leave_view, read_last_view
from bench.run.status import read_status, status_text
from calib.model.cause import Cause
from calib.target import StarTarget
from calib.view import View

BEGUN = datetime(2026, 3, 1, 20, 0, tzinfo=UTC)


@functools.cache
def plan():
    return make_plan(*load_documents("three_pose", "simulated")).to_dict()


class Run:
    """A run folder and its journal, of a process that goes on or has died."""

    def __init__(self, path):
        self.folder = RunFolder.create(path)
        self.path = path
        self.now = BEGUN
        self.folder.write_atomic("plan.json", json.dumps(plan()).encode())
        clock = SimpleNamespace(utc_now=lambda: self.now, monotonic=lambda: 0.0)
        self.journal = Journal.create(self.folder.journal_path, clock)
        self.tell(Event.RUN_STARTED, id="run-7", simulated=True)

    def tell(self, event, **data):
        self.journal.append(event, **data)

    def status(self, after_s=0.0):
        return read_status(self.path, lambda: self.now + timedelta(seconds=after_s))

    def die(self):
        self.journal.close()
        self.folder.close()


@pytest.fixture
def run(tmp_path):
    run = Run(tmp_path / "run")
    yield run
    run.die()


def test_a_running_run_shows_state_pose_and_time_left(run):
    run.tell(Event.ENTERING, state="recording", pose=2)
    status = run.status(after_s=3.0)
    assert status.running
    assert (status.state, status.pose, status.pose_name, status.poses) == ("recording", 2, "right", 3)
    assert status.left_s == pytest.approx(plan()["duration_s"] - 3.0, abs=0.1)
    assert "pose 2 of 3 (right)" in status_text(status)
    assert "SIMULATED" in status_text(status)
    assert status.advice.endswith("abort")
    assert json.loads(json.dumps(status.to_dict(), allow_nan=False))["schema"] == "starbench/status/1"


def test_a_held_run_shows_its_holder_and_its_time_does_not_count(run):
    run.tell(Event.COMMANDED, id="x", word="hold", by="ada@lab", taken=True, why="")
    status = run.status(after_s=1000.0)
    assert status.held_by == "ada@lab"
    assert status.left_s == pytest.approx(plan()["duration_s"], abs=0.1)
    assert "HELD by ada@lab" in status_text(status)
    assert status.advice.endswith("release")


@pytest.mark.parametrize(
    ("event", "data", "told"),
    [
        (
            Event.ENTERING,
            {"state": "holding", "rule": "door", "why": "it is open", "pose": 1},
            "HELD by the door interlock: it is open",
        ),
        (
            Event.ASKED,
            {"step": 2, "text": "Is the cap off?", "default": "yes", "timeout_s": 600.0},
            "Is the cap off?",
        ),
    ],
    ids=["an interlock", "a question"],
)
def test_while_a_run_waits_it_says_for_what_and_its_time_left_does_not_pass(run, event, data, told):
    run.tell(event, **data)
    status = run.status(after_s=1000.0)
    assert told in status_text(status)
    assert status.left_s == pytest.approx(plan()["duration_s"], abs=0.1)
    run.tell(Event.RUN_ENDED, how="aborted", why="")
    assert "HELD" not in status_text(run.status())


def test_a_sealed_run_whose_journal_was_emptied_is_not_called_interrupted_or_finished(run):
    run.die()
    run.folder.journal_path.write_bytes(b"")
    (run.path / "SHA256SUMS.sig").write_text("a seal")
    text = status_text(run.status())
    assert "sealed, but" in text
    assert "starbench verify" in text
    assert not any(word in text for word in ("interrupted", "Finished", "CHECK THE BENCH"))


def test_a_killed_run_is_not_running_and_not_held(run):
    run.tell(Event.COMMANDED, id="x", word="hold", by="ada@lab", taken=True, why="")
    run.tell(Event.ENTERING, state="slewing", pose=1)
    run.die()
    status = run.status()
    assert (status.running, status.held_by, status.left_s) == (False, "", None)
    assert "slewing, pose 1 of 3 (left)" in status_text(status)
    assert [device["state"] for device in status.to_dict()["devices"]] == ["not confirmed"] * 3
    assert "CHECK THE BENCH" in status_text(status)
    assert "stage may be moving" in status_text(status)
    assert "starbench resume" in status.advice


def test_a_run_that_has_ended_says_how_each_device_was_left_and_how_late_the_computer_was(run):
    ends = [{"device": "stage", "state": "confirmed safe", "said": "it stands"}]
    ends += [{"device": "light", "state": "not confirmed", "said": "no reply"}]
    lateness = {"lost_s": 31.4, "longest_s": 2.12}
    run.tell(Event.ENTERING, state="slewing", pose=1)
    run.tell(Event.COMPUTER_BUSY, late_s=7.4, window_s=10.0, lateness=lateness)
    assert run.status().devices == ()
    assert "Computer busy: 7.4 s late in 10 s" in status_text(run.status())
    run.tell(Event.RUN_ENDED, how="failed", why="gone", devices=ends, lateness=lateness)
    run.die()
    assert run.status().to_dict()["devices"] == ends
    text = status_text(run.status())
    assert "light: not confirmed" in text
    assert "31 s were lost" in text
    assert "Computer busy" not in text


def test_a_run_that_never_began_claims_nothing_of_the_devices(run):
    run.die()
    assert [device.state for device in run.status().devices] == ["never opened"] * 3
    assert "CHECK" not in status_text(run.status())


def test_the_last_lines_are_shown_as_text(run):
    run.tell(Event.ENTERING, state="checking", pose=1)
    run.tell(Event.LEFT_OFF, state="checking")
    run.tell(Event.CAPTURE_STORED, pose=1, pose_name="left", attempt=1, capture="captures/a.raw")
    run.tell(Event.ATTEMPT_CHECKED, pose=1, attempt=1, accepted=False, reasons=["dark", "shaky"])
    run.tell(Event.LEFT_OFF, state="recording", error="PortLost: gone")
    run.tell(Event.POSE_SKIPPED, pose=1, pose_name="left", what="Pose 1 was skipped: so.")
    assert all(line[9:14] == "UTC  " for line in run.status().last)
    assert [line[14:] for line in run.status().last] == [
        "checking at pose 1",
        "stored captures/a.raw",
        "attempt 1 at pose 1: dark; shaky",
        "recording failed: PortLost: gone",
        "deviation: Pose 1 was skipped: so.",
    ]
    assert run.status().deviations == ("Pose 1 was skipped: so.",)


def test_the_reason_of_a_failure_is_told_once_and_its_page_is_named(run):
    reason = "The image is out of focus. Focus the lens."
    run.tell(Event.CAPTURE_STORED, pose=1, pose_name="left", attempt=1, capture="captures/a.raw")
    run.tell(Event.ATTEMPT_CHECKED, pose=1, attempt=1, accepted=False, reasons=[reason])
    why = f"captures/a.raw: Pose 1 (left) failed 1 attempt: {reason} All attempts are kept."
    run.tell(Event.ENTERING, state="failed", pose=None)
    run.tell(Event.RUN_ENDED, how="failed", why=why)
    (run.path / "report.html").write_text("page")
    text = status_text(run.status())
    assert text.count("out of focus") == 1
    assert "pose 1: as above" in text
    assert f"Report: {run.path / 'report.html'}" in text


def test_the_name_of_a_run_folder_writes_no_line_of_its_own(tmp_path):
    run = Run(tmp_path / "run\nSEALED: 20 files")
    run.tell(Event.RUN_STARTED, id=run.path.name)
    run.tell(Event.RUN_ENDED, how="finished", why="")
    (run.path / "report.html").write_text("page")
    run.die()
    text = status_text(run.status())
    assert r"Run run\nSEALED: 20 files" in text
    assert rf"Report: {tmp_path}/run\nSEALED: 20 files/report.html" in text
    assert not any(line.startswith("SEALED") for line in text.splitlines())


# ---------------------------------------------------------------- the picture of the last recording


def _measurement(fault=""):
    image = np.arange(40 * 30, dtype=np.float32).reshape(30, 40)
    ids = np.array([3, 4, 9])
    target = StarTarget()
    points_px = np.array([[1.23456, 2.0], [3.0, 4.0], [5.0, 6.0]])
    view = View("left", (40, 30), ids, points_px, target.positions_mm(ids), np.tile(np.eye(2), (3, 1, 1)))
    return Measurement(None if fault else view, StoredImage.from_image(image), {}, fault)


def test_a_picture_is_left_and_read_again(tmp_path):
    (tmp_path / CONTROL).mkdir()
    measurement = _measurement()
    leave_view(tmp_path, 2, 1, measurement, StarTarget())
    left = read_last_view(tmp_path)
    assert (left.pose, left.attempt) == (2, 1)
    assert left.nodes == StarTarget().node_of([3, 4, 9]).tolist()
    assert left.points_px[0] == [1.235, 2.0]
    assert left.png == measurement.image.png
    leave_view(tmp_path, 2, 2, _measurement("no stars"), StarTarget())
    left = read_last_view(tmp_path)
    assert (left.attempt, left.nodes, left.fault) == (2, [], "no stars")


def test_without_an_inbox_or_an_image_nothing_is_left(tmp_path):
    leave_view(tmp_path, 1, 1, _measurement(), StarTarget())
    (tmp_path / CONTROL).mkdir()
    leave_view(tmp_path, 1, 1, Measurement(None, None), StarTarget())
    assert read_last_view(tmp_path) is None
    assert not list((tmp_path / CONTROL).iterdir())


@pytest.mark.parametrize("text", [b"", b"{}\n", b"[1]\n", b'{"pose": 1', b"\xff\xfe\n"])
def test_a_damaged_file_is_no_picture(tmp_path, text):
    (tmp_path / CONTROL).mkdir()
    (tmp_path / CONTROL / LAST_VIEW).write_bytes(text)
    assert read_last_view(tmp_path) is None


# ---------------------------------------------------------------- an accepted command is done

PROMPT = '  - prompt: {text: "Cap off?", default: abort, timeout_s: 5}\n'


@pytest.fixture
def scene(tmp_path, monkeypatch):
    return lambda **words: with_runner(Scene(tmp_path, **words), monkeypatch)


def commanded(scene, word, **more):
    scene.runner.context.log.write(Commanded, id="x", word=word, by="ada", taken=True, why="", **more)


def test_an_answer_accepted_at_the_last_moment_counts(scene, monkeypatch):
    played = scene(end=PROMPT)

    def asked_in_vain(*_, **__):
        commanded(played, "answer", answer="continue")
        return Reply("abort", "time-out")

    monkeypatch.setattr("bench.run.states.ask", asked_in_vain)
    assert played.run().how == "finished"
    assert [(d["answer"], d["by"]) for d in played.data_of(Event.ANSWERED)] == [("continue", "ada")]


def test_a_pose_skipped_during_its_last_attempt_is_skipped_and_does_not_end_the_run(scene):
    played = scene(attempts=1)

    def hook(name):
        if name == "camera.record" and played.calls.count("camera.record") == 1:
            commanded(played, "skip", pose=1)
            return lambda facts: replace(facts, complete=False)
        return None

    played.hook = hook
    assert played.run().how == "finished"
    assert [d["pose"] for d in played.data_of(Event.POSE_SKIPPED)] == [1]


def test_the_verdict_and_its_causes_are_told_before_the_numbers(run):
    cause = Cause("computer stood still", 100.0, 60.0, unit="s").to_dict()
    numbers = {"values": {"fx": 3300.0, "fy": 3300.0}, "sigma": {"fx": 1.0, "fy": 1.0}}
    run.tell(Event.SOLVED, model="m", converged=True, rms_px=0.1, **numbers, causes=[cause])
    verdict = {"kind": "marginal", "headline": "Calibrated, with reservations."}
    run.tell(Event.WRITTEN, head="", files={}, verdict=verdict)
    run.tell(Event.RUN_ENDED, how="finished", why="")
    lines = status_text(run.status()).splitlines()
    at = lines.index("Calibrated, with reservations.")
    assert lines[at + 1].startswith("This computer stood still")
    assert lines[at + 2].startswith("Result: fx 3300")
    run.die()


def test_a_run_whose_process_is_suspended_is_told_as_such_and_how_it_continues(run):
    run.tell(Event.ENTERING, state="recording", pose=2)
    run.die()
    inbox_of(run.path).folder.mkdir()
    with locking(run.path) as process:
        assert run.status().advice.endswith("abort")
        assert run.status().left_s is not None
        suspend(process)
        status = run.status()
        assert status.left_s is None
        with pytest.raises(RunFolderError, match=f"kill -CONT {process.pid}"):
            send(run.path, Command(word="abort", by="somebody"), patience_s=0.01)
    assert f"suspended process {process.pid}" in status_text(status)
    assert f"kill -CONT {process.pid}" in status.advice

"""Which steps a resumed run still has to do, what they depend on, and which poses are skipped."""

from datetime import UTC, datetime

import pytest

from bench.base.clock import VirtualClock
from bench.plan.job import Job
from bench.record.events import Event
from bench.record.history import Attempt, History, replay
from bench.record.journal import Journal
from bench.run.steps_to_do import (
    intentions,
    poses_crashed_too_often,
    remaining_steps,
    steps_of_pose,
    steps_to_repeat,
)
from sequences.script import MoveStep, RecordStep, SettleStep


@pytest.fixture(scope="module")
def job():
    return Job.from_files("three_pose", "simulated", seed=1, operator=None)


@pytest.fixture(scope="module")
def steps(job):
    """1 light, then move, settle, record (2-4, 5-7, 8-10), 11 light off, park, 12 solve, 13 report."""
    return job.steps


def numbers(steps):
    return [step.number for step in steps]


@pytest.mark.parametrize(
    ("done", "first"),
    [(6, [5, 6, 7]), (5, [5, 6]), (7, [8]), (4, [5])],
    ids=["recording", "settling", "moving", "moved"],
)
def test_what_a_step_depends_on_is_repeated(steps, done, first):
    assert numbers(remaining_steps(steps, range(1, done + 1)))[: len(first)] == first


def test_a_recording_depends_on_its_move_and_a_move_on_nothing(steps):
    by_number = {step.number: step for step in steps}
    assert [type(s) for s in steps_to_repeat(steps, by_number[7])] == [MoveStep, SettleStep]
    assert [type(s) for s in steps_to_repeat(steps, by_number[6])] == [MoveStep]
    assert steps_to_repeat(steps, by_number[5]) == []
    assert steps_to_repeat(steps, by_number[11]) == []


def test_a_move_for_two_recordings_is_not_skipped_with_one_of_them(steps):
    twice = (*steps[:4], RecordStep(**{**vars(steps[3]), "number": 99, "pose": steps[6].pose}), *steps[4:6])
    assert numbers(steps_of_pose(twice, 1)) == [4]


# ---------------------------------------------------------------- a pose that crashes the process


def lived(tmp_path, *lines):
    now = datetime(2026, 3, 1, tzinfo=UTC)
    with Journal.create(tmp_path / "j", VirtualClock(now)) as journal:
        for event, data in lines:
            journal.append(event, **data)
        return replay(journal.entries)


RECORDING = (Event.ENTERING, {"state": "recording", "pose": 2})
SETTLING = (Event.ENTERING, {"state": "settling"})
LIGHTING = (Event.ENTERING, {"state": "lighting"})
KILLED = (Event.RUN_RESUMED, {})
CRASHED = (Event.RUN_RESUMED, {"crash": "Fatal Python error: Segmentation fault"})
UNFORESEEN = (Event.RUN_ENDED, {"how": "failed", "why": "x", "crashed": True})
FAILED = (Event.RUN_ENDED, {"how": "failed", "why": "x"})


@pytest.mark.parametrize(
    ("lines", "crashes"),
    [
        ([RECORDING, CRASHED, RECORDING, CRASHED], {2: 2}),
        ([RECORDING, SETTLING, CRASHED], {2: 1}),
        ([RECORDING, UNFORESEEN, KILLED, RECORDING, CRASHED], {2: 2}),
        ([RECORDING, KILLED, RECORDING, KILLED, RECORDING, KILLED], {}),
        ([RECORDING, FAILED, KILLED], {}),
        ([RECORDING, LIGHTING, CRASHED], {}),
        ([RECORDING, CRASHED, CRASHED], {2: 1}),
    ],
)
def test_crashes_count_against_the_pose_at_work_and_kills_do_not(tmp_path, lines, crashes):
    assert lived(tmp_path, *lines).crashes == crashes


def test_one_crash_at_a_pose_is_allowed_and_two_are_not(tmp_path):
    assert poses_crashed_too_often(History(crashes={2: 1})) == {}
    assert "crashed 2 times" in poses_crashed_too_often(History(crashes={2: 2}))[2]
    assert poses_crashed_too_often(History(crashes={2: 2}, skipped={2: "so"})) == {}


# ---------------------------------------------------------------- what resuming says first


def test_resuming_states_what_is_kept_recorded_and_skipped(job):
    history = History(done_steps={1, 2, 3, 4, 5}, at_pose=2, crashes={2: 1}, to_skip={3: "ada"})
    history.add(Attempt(1, "left", 1, {}, {"accepted": True}, "", ""))
    text = "\n".join(intentions(job, history, "Fatal Python error: Aborted"))
    assert "Fatal Python error: Aborted" in text
    assert "1 of 3 poses" in text
    assert "Skip pose 2 (right)" in text
    assert "Skip pose 3 (below)" in text
    assert "Record pose" not in text
    assert text.endswith("Then: solve, report, seal.")
    assert history.crashes == {2: 1}


def test_resuming_names_each_pose_to_record_and_the_repeated_move(job):
    sentences = intentions(job, History(done_steps={1, 2, 3, 4, 5}), None)
    assert "power lost" in sentences[0]
    assert "Record pose 2 (right)." in sentences
    assert "Record pose 3 (below)." in sentences
    assert any("pose right again" in sentence for sentence in sentences)


def test_a_recording_that_is_gone_is_made_again_and_all_is_solved_again(job):
    history = History(done_steps=set(range(1, 14)))
    for index, name in enumerate(("left", "right", "below"), start=1):
        history.add(Attempt(index, name, 1, {"capture": name}, {"accepted": True}, "", ""))
    sentences = intentions(job, history, None, ["right"])
    assert [sentence for sentence in sentences if "Record" in sentence] == ["Record pose 2 (right)."]
    assert sentences[-1] == "Then: solve, report, seal."
    assert list(history.accepted()) == [1, 2, 3]


def test_a_finished_run_is_only_sealed(job):
    assert "seal is missing" in intentions(job, History(ended="finished"), None)[0].lower()

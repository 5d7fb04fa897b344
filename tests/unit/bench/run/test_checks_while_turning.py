"""A recording is checked while the stage turns to the next pose; a rejected one is taken again, and nothing else is."""

import re
import shutil
from itertools import pairwise

import pytest
from quick_runs import THREE
from rehearsed import Scene, with_runner

import bench.batch.rehearsal
from bench.base.clock import BenchClock
from bench.measure.measure import Measurement
from bench.plan.plan import CHECK_S
from bench.record.events import Event
from bench.record.journal import read_journal
from bench.run.control import Command
from sequences.script import RecordStep

SKIP = Command(word="skip", by="ada", pose=1)


@pytest.fixture
def scene(tmp_path):
    return Scene(tmp_path, poses=THREE)


@pytest.fixture
def reject(monkeypatch):
    """Let recordings of these names be rejected."""
    rejected = set()
    measure = bench.batch.rehearsal.RehearsedKind.measure

    def measured(kind, path, *given, **more):
        measurement = measure(kind, path, *given, **more)
        return Measurement(None, None, measurement.facts, "spoilt") if path.stem in rejected else measurement

    monkeypatch.setattr(bench.batch.rehearsal.RehearsedKind, "measure", measured)
    return rejected.update


def story(scene):
    """What the run did, in order: ``slew 2``, ``record 2``, ``accept 2``, ``reject 2``."""
    words = {"slewing": "slew", "recording": "record"}
    steps = []
    for event, data in scene.events():
        if event == Event.ENTERING and data["state"] in words:
            steps.append(f"{words[data['state']]} {data['pose']}")
        elif event == Event.ATTEMPT_CHECKED:
            steps.append(f"{'accept' if data['accepted'] else 'reject'} {data['pose']}")
    return ", ".join(steps)


def see_each_pose_once(scene):
    """Each pose is accepted once, where it was commanded, and every step is done once."""
    history = scene.history()
    assert sorted(history.accepted()) == [1, 2, 3]
    accepted = [data["pose"] for data in scene.data_of(Event.ATTEMPT_CHECKED) if data["accepted"]]
    assert sorted(accepted) == [1, 2, 3]
    done = [data["step"] for data in scene.data_of(Event.STEP_DONE)]
    assert len(done) == len({*done})
    for stored in scene.data_of(Event.CAPTURE_STORED):
        for axis, angle_deg in stored["commanded_deg"].items():
            assert stored["measured_deg"][axis] == pytest.approx(angle_deg, abs=0.05)


def test_a_run_waits_only_for_what_is_left_of_a_check_and_the_plan_counts_so(scene):
    scene.run()
    entries, _ = read_journal(scene.folder / "journal.jsonl")
    waited_s = [
        after.mono_s - before.mono_s
        for before, after in pairwise(entries)
        if before.event == Event.ENTERING and before.data["state"] == "checking"
    ]
    assert waited_s[0] < CHECK_S / 2
    assert waited_s[2] == pytest.approx(CHECK_S)
    planned_s = [step.duration_s for step in scene.task.plan.steps if isinstance(step.step, RecordStep)]
    assert planned_s[2] - planned_s[0] == pytest.approx(waited_s[2] - waited_s[0], abs=0.1)


@pytest.mark.parametrize("pose", [1, 2, 3])
def test_a_rejected_pose_is_taken_again_at_once_and_then_the_run_goes_on(scene, reject, pose):
    reject({f"pose-{pose:03d}-attempt-1"})
    assert scene.run().how == "finished"
    course = story(scene)
    onward = f"slew {pose + 1}, " if pose < 3 else ""
    back = f"slew {pose}, " if pose < 3 else ""
    assert f"record {pose}, {onward}reject {pose}, {back}record {pose}, accept {pose}" in course
    if pose < 3:
        assert f"accept {pose}, slew {pose + 1}, record {pose + 1}" in course
    see_each_pose_once(scene)


def test_a_run_killed_after_any_line_keeps_every_pose_and_repeats_none(reject, tmp_path):
    """Also where the stage stood at the next pose already, and where it was on its way back."""
    scene = Scene(tmp_path, poses=THREE)
    reject({"pose-002-attempt-1"})
    assert scene.run().how == "finished"
    data = (scene.folder / "journal.jsonl").read_bytes()
    lines = data.splitlines(keepends=True)
    for count in range(1, len(lines)):
        cut = Scene(tmp_path, poses=THREE)
        cut.folder = tmp_path / f"cut-{count}"
        shutil.copytree(scene.folder, cut.folder)
        (cut.folder / "journal.jsonl").write_bytes(b"".join(lines[:count]) + lines[count][:7])  # and one torn
        assert cut.run().how == "finished", count
        see_each_pose_once(cut)
        assert cut.data_of(Event.RUN_RESUMED)[0]["torn_bytes"] == 7
        stored = len(re.findall(rb'"event":"capture_stored"', b"".join(lines[:count])))
        kept, whole = ([data["sha256"] for data in of.data_of(Event.CAPTURE_STORED)] for of in (cut, scene))
        assert kept[:stored] == whole[:stored]
        assert len(cut.data_of(Event.CAPTURE_STORED)) - stored <= 4 - stored, count


def test_a_pose_in_check_that_an_operator_skips_counts_if_it_is_accepted_and_is_skipped_if_not(
    tmp_path, reject, monkeypatch
):
    for name, rejected, poses in (("good", set(), [1, 2, 3]), ("bad", {"pose-001-attempt-1"}, [2, 3])):
        (tmp_path / name).mkdir()
        scene = with_runner(Scene(tmp_path / name, poses=THREE), monkeypatch)
        reject(rejected)
        scene.at("stage.move_to", 2, lambda scene=scene: scene.runner.inbox.decide(SKIP, "request"))
        assert scene.run().how == "finished"
        history = scene.history()
        assert sorted(history.accepted()) == poses, name
        assert (1 in history.skipped) is (name == "bad")


def test_work_in_parallel_goes_on_while_the_caller_waits_and_its_error_is_raised_where_its_result_is_asked_for():
    clock = BenchClock()
    result = clock.in_parallel(lambda: 6 * 7)
    assert result() == 42

    def fail():
        raise OSError("no such recording")

    failed = clock.in_parallel(fail)
    with pytest.raises(OSError, match="no such recording"):
        failed()

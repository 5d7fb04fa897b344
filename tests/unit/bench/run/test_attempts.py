"""What a run does when a pose keeps failing its gates: attempts kept, then skipped, held or failed, as written; and one that an operator skips."""

from datetime import UTC, datetime, timedelta

from quick_runs import END, THREE, write_sequence
from rehearsed import TWO, Scene, with_runner

from bench.base.progress import Progress
from bench.record.events import Event
from bench.record.history import Attempt, History
from bench.run.control import Command
from bench.run.steps import seen_before
from bench.solve.results_content import pose_data


def doomed(folder, on_failure, attempts=2):
    """Two poses that pass and, before them, one that cannot."""
    text = write_sequence(folder / "s.yaml", TWO, attempts=attempts, end=END).read_text()
    record = f"record: {{gates: {{min_stars: 100000}}, on_failure: {on_failure}, hold_s: 1}}"
    pose = f"  - move: {{name: doomed, tilt_deg: -3}}\n  - settle\n  - {record}\n"
    (folder / "s.yaml").write_text(text.replace("  - repeat:\n", pose + "  - repeat:\n", 1))
    return Scene(folder, sequence=folder / "s.yaml")


def content(scene):
    """What the results would tell of the poses."""
    history = scene.history()
    return {"poses": pose_data(history, [], scene.task.camera_kind), "deviations": history.deviations}


def test_between_attempts_it_waits_twice_as_long_each_time(tmp_path):
    scene = doomed(tmp_path, "fail", attempts=4)
    end = scene.run()
    assert (end.how, scene.states()[-1]) == ("failed", "failed")
    assert "(doomed) failed 4 attempts" in end.why
    entered = scene.data_of(Event.ENTERING)
    assert [state["wait_s"] for state in entered if state["state"] == "backing_off"] == [0.1, 0.2, 0.4, 0.0]


def test_a_pose_that_is_held_with_nobody_there_ends_the_run_safely_and_resumable(tmp_path):
    scene = doomed(tmp_path, "hold")
    assert scene.run().how == "aborted"
    assert not scene.light_is_on()
    first = scene.events()
    (asked,) = scene.data_of(Event.ASKED)
    assert "Try it again?" in asked["text"]
    assert scene.run().how == "aborted"
    assert [capture["attempt"] for capture in scene.data_of(Event.CAPTURE_STORED)] == [1, 2, 3, 4]
    assert scene.events()[: len(first)] == first  # nothing written is written over


def test_a_run_that_its_holder_has_forgotten_is_aborted_after_eight_hours_in_the_dark(tmp_path, monkeypatch):
    scene = with_runner(Scene(tmp_path, poses=THREE, end=END), monkeypatch)
    scene.at("stage.home", 1, lambda: scene.runner.inbox.decide(Command(word="hold", by="ada"), "one"))
    began = scene.clock.monotonic()
    assert scene.run().how == "aborted"
    assert 8.0 < (scene.clock.monotonic() - began) / 3600 < 8.1
    assert not scene.light_is_on()


def test_a_skipped_pose_is_left_out_and_the_results_say_who_asked(tmp_path, monkeypatch):
    scene = with_runner(Scene(tmp_path, poses=THREE, end=END), monkeypatch)

    def skip_twice():
        for request in ("one", "again"):
            scene.runner.inbox.decide(Command(word="skip", by="ada", pose=2), request)

    scene.at("stage.home", 1, skip_twice)
    assert scene.run().how == "finished"
    answers = scene.data_of(Event.COMMANDED)
    assert [answer["taken"] for answer in answers] == [True, False]
    assert "already skipped" in answers[1]["why"]
    results = content(scene)
    assert [pose["index"] for pose in results["poses"]] == [1, 3]
    (deviation,) = results["deviations"]
    assert deviation.endswith("ada asked for it.")


def measured(pose, stars, **facts):
    """A recording at a pan angle of ten degrees a pose, one every 125 s, accepted if it shows stars."""
    checked = {"accepted": stars > 0, "stars": stars, "reasons": [], "measured": facts}
    utc = (datetime(2026, 1, 1, tzinfo=UTC) + timedelta(seconds=125 * pose)).isoformat()
    return Attempt(pose, f"p{pose}", 1, {"commanded_deg": {"pan": 10.0 * pose}}, checked, utc)


def test_a_pose_without_stars_is_told_what_this_run_saw_before():
    history = History()
    history.add(measured(1, 203, edge_width_px=0.618))
    history.add(measured(2, 0))
    before = seen_before(history, 2)
    assert all(fact in before for fact in ("pose 1", "pan 10", "203 stars", "0.62 px", "2 min 5 s before"))
    assert seen_before(history, 1) == ""  # it shows stars
    alone = History()
    alone.add(measured(1, 0))
    assert seen_before(alone, 1) == ""


def test_a_pose_that_keeps_failing_is_skipped_and_what_the_last_run_saw_there_is_told_only(
    tmp_path, monkeypatch
):
    last = {
        "run": {"id": "run-7", "finished_utc": "2026-01-01T12:00:00"},
        "poses": [{"name": "doomed", "stars": 203}],
    }
    monkeypatch.setattr("bench.run.steps.last_results", lambda *_: last)
    said = []
    monkeypatch.setattr(Progress, "say", lambda _, text: said.append(text))
    scene = doomed(tmp_path, "skip")
    assert scene.run().how == "finished"
    results = content(scene)
    attempts = [[attempt["accepted"] for attempt in pose["attempts"]] for pose in results["poses"]]
    assert attempts == [[False, False], [True], [True]]
    (deviation,) = results["deviations"]
    assert deviation.startswith("Pose 1 (doomed) failed 2 attempts")
    assert [text for text in said if "run-7" in text and "203 stars" in text]
    assert "run-7" not in (scene.folder / "journal.jsonl").read_text()

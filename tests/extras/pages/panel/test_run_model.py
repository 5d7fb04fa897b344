"""A run as its page shows it: poses, log, last recording, verdict, times, and whether it can be left alone."""

import json
from datetime import datetime, timedelta

import pytest
from journals import BEGIN, MadeRun

from bench.extras.pages.panel.folder_list import FolderList
from bench.extras.pages.panel.journal_tail import read_final
from bench.extras.pages.panel.run_head import ProcessState, head_of, look_at_process
from bench.extras.pages.panel.run_model import RunModel

RUNNING = ProcessState(running=True, takes_commands=True, free_bytes=10**12)


def _read(run):
    model = RunModel(run.folder)
    while model.refresh():
        pass
    return model


def _head(run, process=RUNNING, after_s=0.0):
    model = run if isinstance(run, RunModel) else _read(run)
    now = datetime.fromisoformat(model.history.states[-1]["utc"]) if model.history.states else BEGIN
    head = head_of(model, process, now + timedelta(seconds=after_s))
    json.dumps(head, allow_nan=False)
    return head


@pytest.fixture
def run(tmp_path):
    return MadeRun(tmp_path / "run7").begin()


def _states(model):
    return [row["state"] for row in model.changed_rows(0)]


def test_poses_follow_the_journal(run):
    model = _read(run)
    assert _states(model) == ["planned"] * 3
    run.record(1)
    run.record(2, accepted=False, stars=3)
    model.refresh()
    assert _states(model) == ["accepted", "rejected", "planned"]
    assert model.rows[2]["why"].startswith("3 stars")
    run.record(2, attempt=2)
    run.write("pose_skipped", pose=3, pose_name="pose 3", what="Pose 3 was skipped: Ada asked for it.")
    model.refresh()
    assert _states(model) == ["accepted", "accepted", "skipped"]
    assert (model.rows[2]["attempts"], model.rows[2]["why"]) == (2, "")


def test_a_pose_is_at_work_until_the_next_one(run):
    run.enter("slewing", "homing", step=1, pose=1, pose_name="pose 1", target_deg={})
    model = _read(run)
    assert _states(model) == ["at work", "planned", "planned"]
    run.enter("slewing", "slewing", step=3, pose=2, pose_name="pose 2", target_deg={})
    model.refresh()
    assert _states(model) == ["planned", "at work", "planned"]
    run.enter("parking", "slewing", step=0)
    model.refresh()
    assert _states(model) == ["planned"] * 3


def test_the_head_counts(run):
    run.record(1)
    run.record(2, accepted=False)
    run.record(2, attempt=2)
    head = _head(run)
    assert (head["accepted"], head["poses"], head["recordings"], head["retries"]) == (2, 3, 3, 1)
    assert (head["verdict"], head["tone"]) == ("running", "busy")
    assert head["last"]["checked"]["stars"] == 200
    assert head["gate_failures"] == {"stars": 1}
    assert head["last"]["stored"]["light"]["frequency_hz"] == 60.0
    assert head["last"]["stored"]["measured_deg"] == {"pan": 0.02, "tilt": -0.02}


def test_the_verdict_of_a_recording_is_never_that_of_another_one(run):
    run.record(1)
    lines = list(run.pose_lines(2, 1, True, 9))
    with run.path.open("ab") as stream:
        stream.writelines(lines[:5])  # stored, not checked yet
    last = _head(run)["last"]
    assert (last["stored"]["pose"], last["checked"]) == (2, None)
    assert last["before"]["gates"][0]["value"] == 200
    assert (last["before"]["pose"], last["before"]["attempt"]) == (1, 1)  # whose picture is shown meanwhile


@pytest.mark.parametrize(
    ("how", "process", "verdict"),
    [
        ("finished", ProcessState(sealed=True), "finished"),
        ("finished", ProcessState(), "not sealed"),
        ("finished", RUNNING, "being sealed"),
        ("aborted", ProcessState(), "aborted"),
        ("failed", ProcessState(), "failed"),
    ],
)
def test_verdicts_of_ended_runs(run, how, process, verdict):
    run.record_all().end(how)
    head = _head(run, process)
    assert head["verdict"] == verdict
    assert head["left_s"] is None
    assert not any(head["can"].values())


CAUSE = {
    "kind": "computer stood still", "evidence": 100.0, "value": 60.0, "expanded": None, "unit": "s", "stated": None,
    "axis": "", "before": "", "pose": "", "beside": [], "explains": [],
}  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "headline", "causes", "tone"),
    [
        ("pass", "Calibrated.", [], "good"),
        ("marginal", "Calibrated, with reservations.", [CAUSE], "warn"),
        ("fail", "Calibrated, but 1 of 2 gates fails.", [], "bad"),
    ],
)
def test_a_finished_run_is_green_only_if_its_report_has_no_reservation(run, kind, headline, causes, tone):
    run.record_all()
    solved = {"model": "m", "converged": True, "rms_px": 0.1, "values": {}, "sigma": {}, "causes": causes}
    run.write("solved", **solved)
    run.write("written", head="", files={}, verdict={"kind": kind, "headline": headline})
    run.end("finished")
    head = _head(run, ProcessState(sealed=True))
    assert (head["verdict"], head["tone"], head["headline"]) == ("finished", tone, headline)
    assert ["60 s" in text for text in head["causes"]] == [True] * len(causes)
    (listed,) = FolderList(run.folder).look()["runs"]
    assert ("60 s" in listed["headline"]) == bool(causes)


def test_a_killed_run_is_not_called_safe(run):
    run.record(1)
    head = _head(run, ProcessState())
    assert head["verdict"] == "interrupted"
    assert not head["leave"]["safe"]
    assert "left the bench" in head["leave"]["text"]


def test_a_question_ahead_ends_the_time_alone(tmp_path):
    run = MadeRun(tmp_path / "run", prompt=True).begin()
    run.record(1)
    leave = _head(run)["leave"]
    assert not leave["safe"]
    assert leave["until_utc"] > BEGIN.isoformat()
    run.write("step_done", step=7)  # the question is answered
    assert _head(run)["leave"]["safe"]


@pytest.mark.parametrize(
    ("event", "text"),
    [
        ({"event": "asked", "step": 7, "text": "Dark?", "default": "continue", "timeout_s": 60.0}, "waits for an answer"),
        ({"event": "commanded", "id": "1", "word": "hold", "by": "Ada", "taken": True, "why": ""}, "Ada has asked for a hold"),
        ({"event": "entering", "state": "holding", "from": "x", "rule": "door", "why": "the door is open"}, "The door interlock"),
    ],
)  # fmt: skip
def test_what_needs_a_person_says_so(run, event, text):
    run.write(event.pop("event"), **event)
    leave = _head(run)["leave"]
    assert not leave["safe"]
    assert text in leave["text"]


def test_a_silent_process_and_a_full_disk_need_a_person(run):
    run.record(1)
    silent = ProcessState(running=True, takes_commands=True, quiet_s=40.0)
    assert "for 40 s" in _head(run, silent)["leave"]["text"]
    full = ProcessState(running=True, takes_commands=True, free_bytes=10)
    assert "free" in _head(run, full)["leave"]["text"]


def test_rejected_poses_in_a_row_need_a_person(run):
    for pose in (1, 2, 3):
        run.record(pose, accepted=False)
    assert "last 3 poses were rejected" in _head(run)["leave"]["text"]


@pytest.mark.parametrize("how", ["finished", "aborted", "failed"])
def test_a_device_that_did_not_confirm_that_it_is_safe_is_told_after_the_end(run, how):
    light = {"device": "light", "state": "not confirmed", "said": "the light does not answer."}
    camera = {"device": "camera", "state": "not confirmed", "said": "gone"}
    run.end(how, "why", devices=[light, camera])
    head = _head(run, ProcessState(sealed=True))
    (unsafe,) = head["unsafe"]
    assert unsafe.startswith("light: not confirmed")
    assert head["leave"]["safe"] is False
    assert unsafe in head["leave"]["text"]


def test_the_time_left_is_scaled_by_what_the_steps_took(tmp_path):
    run = MadeRun(tmp_path / "run", 10).begin()
    for pose in (1, 2, 3, 4):
        run.record(pose)
    model = _read(run)
    pace = 0.6  # 0.2 s to move and 0.4 s to record, where 1 s was planned
    assert model.time_left.pace == pytest.approx(pace)
    left_s = (6 * 1.0 + 1.0) * pace  # six poses of two steps, and the calibration
    last = datetime.fromisoformat(model.log[-1]["utc"]) + timedelta(seconds=0.1)
    assert model.time_left.left_s(last, held=False) == pytest.approx(left_s, abs=0.01)
    # The step of 0.3 s is late by 0.7 s, and expected to need as long again.
    late = model.time_left.left_s(last + timedelta(seconds=1), held=False)
    assert late == pytest.approx(left_s - 0.3 + 0.7, abs=0.01)
    assert model.time_left.left_s(last + timedelta(seconds=1), held=True) == pytest.approx(left_s, abs=0.01)


def test_before_the_first_steps_the_pace_is_that_of_earlier_runs_of_the_bench(tmp_path):
    run = MadeRun(tmp_path / "run", 10).begin(pace=2.5)
    begun = datetime.fromisoformat(_read(run).log[0]["utc"])
    assert _read(run).time_left.left_s(begun, held=True) == 2.5 * 12.0
    for pose in (1, 2, 3, 4):
        run.record(pose)
    assert _read(run).time_left.pace == pytest.approx(0.6)


def test_a_line_of_another_version_is_named(run):
    run.write("attempt_checked", pose=1)
    head = _head(run)
    assert "Line 5" in head["faults"][0]
    assert _head(run, ProcessState())["verdict"] == "not readable"


def test_without_a_plan_the_page_says_so(run):
    (run.folder / "plan.json").write_text("{")
    run.record(1)
    head = _head(run)
    assert "plan.json is damaged" in head["faults"][0]
    assert head["left_s"] is None
    assert head["accepted"] == 1


def test_a_folder_without_a_process_is_looked_at(tmp_path):
    run = MadeRun(tmp_path / "run").begin()
    process = look_at_process(run.folder, "slewing")
    assert process == ProcessState()
    assert "No such file" in look_at_process(tmp_path / "none", "idle").fault


def test_the_final_uncertainties_come_from_the_results(tmp_path):
    assert read_final(tmp_path) == {}
    results = {"calibration": {"coverage_factor": 2.1, "sigma": {"fx": 0.5}}}
    (tmp_path / "results.json").write_text(json.dumps(results))
    assert read_final(tmp_path) == {"coverage_factor": 2.1, "expanded_fx_px": pytest.approx(1.05)}
    results["projection"] = {"worst_corner": {"corner": "top left", "expanded_px": 0.4}}
    (tmp_path / "results.json").write_text(json.dumps(results))
    assert read_final(tmp_path)["worst_corner_px"] == 0.4
    (tmp_path / "results.json").write_text("[]")
    assert read_final(tmp_path) == {}

"""A batch: order, repetition, what follows a failure, and that nothing is done twice or taken for done."""

import json
import re
import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from nights import BEGIN, JOB, begun, hows, night, queue
from quick_runs import write_queue

from bench.base.clock import Aborted, VirtualClock
from bench.base.errors import RunFolderError, ScriptError, UsageError
from bench.batch.batch import worker_command
from bench.batch.batch_plan import plan_of, read_queue
from bench.batch.batch_record import by_priority, items_of
from bench.batch.batch_status import batch_status_text, read_batch_status
from bench.batch.batch_summary import read_batch, summarise
from bench.batch.supervisor import WorkerEnd
from bench.record.events import Event
from bench.record.journal import Journal
from bench.report.batch_page import render_batch
from sequences.queue import Queue
from sequences.reader import check_document

KILLED = WorkerEnd("died", "by SIGKILL", outside=True)
WITHOUT_A = "without a result: a-001"


def resumed(run, times):
    return f"run {run}" + f", resume {run}" * times


@pytest.mark.parametrize(
    ("jobs", "ends", "runs", "how", "why"),
    [
        ("a, times: 2; b, priority: 1", [], "run b-001, run a-001, run a-002", "finished", ""),
        ("a; b", ["failed"] * 2, "run a-001, resume a-001, run b-001", "failed", WITHOUT_A),
        ("a; b", ["died"] * 2, "run a-001, resume a-001, run b-001", "failed", WITHOUT_A),
        ("a; b", ["hung"] * 2, "run a-001, resume a-001, run b-001", "failed", WITHOUT_A),
        ("a, attempts: 1, on_failure: stop; b", ["failed"], "run a-001", "stopped", None),
        ("a, attempts: 5", ["aborted"], "run a-001", "failed", WITHOUT_A),
        ("a; b", [Aborted("SIGTERM received")], "run a-001", "aborted", "SIGTERM received"),
        ("a, attempts: 2", [KILLED, "failed", *[KILLED] * 2], resumed("a-001", 4), "finished", ""),
        ("a, attempts: 2", [KILLED] * 50, resumed("a-001", 9), "failed", WITHOUT_A),
    ],
)
def test_what_is_begun_follows_priorities_and_how_earlier_tries_ended(tmp_path, jobs, ends, runs, how, why):
    pairs = [re.fullmatch("(\\w+)(.*)", job).groups() for job in jobs.split("; ")]
    batch, workers = night(tmp_path, queue(*pairs), *ends)
    summary = batch.run()
    assert ", ".join(begun(workers)) == runs
    assert summary["how"] == how
    assert why is None or summary["why"] == why
    assert json.loads((tmp_path / "summary.json").read_text()) == summary


def cut_off(folder, jobs, *ends):
    """A batch that is killed after some of its runs have ended."""
    with pytest.raises(KeyboardInterrupt):
        night(folder, jobs, *ends, KeyboardInterrupt())[0].run()


def test_settings_of_a_job_are_given_to_its_runs_and_checked_beforehand(tmp_path):
    jobs = queue(("a", ", settings: {station.camera.biases.bias_diff_on: 20, sequence.name: 'x, y'}"))
    (item,) = items_of(jobs.value.jobs, BEGIN)
    words = worker_command(item, tmp_path / "a")
    assert words[-4:] == ["--set", "station.camera.biases.bias_diff_on=20", "--set", "sequence.name=x, y"]
    path = tmp_path / "queue.yaml"
    path.write_bytes(jobs.text)
    assert plan_of(read_queue(path).value.jobs[0]).station.value.camera.biases.bias_diff_on == 20
    path.write_bytes(jobs.text.replace(b"bias_diff_on", b"bias_dif"))
    with pytest.raises(ScriptError, match=r"\(with settings\):\d+:\d+: camera.biases.bias_dif: "):
        read_queue(path)
    path.write_bytes(jobs.text.replace(b"station.camera", b"camera"))
    with pytest.raises(ScriptError, match="settings"):
        read_queue(path)


@pytest.mark.parametrize(
    ("file", "text", "runs", "first", "died"),
    [
        ("SHA256SUMS.sig", b"", ["run b-001"], "finished", False),  # it was sealed as the batch was cut off
        ("journal.jsonl", b"rotten\n", ["run b-001"], "failed", True),
        ("journal.jsonl", b"", ["run a-001", "run b-001"], "finished", False),  # it was still starting
        ("notes", b"", ["resume a-001", "run b-001"], "finished", True),
    ],
)
def test_a_run_that_was_cut_off_is_done_if_sealed_and_failed_if_unreadable(
    tmp_path, file, text, runs, first, died
):
    said: list[str] = []
    jobs = queue(("a", ""), ("b", ""))
    cut_off(tmp_path, jobs)
    (tmp_path / "runs" / "a-001" / file).write_bytes(text)
    batch, workers = night(tmp_path, jobs, say=said.append)
    summary = batch.run()
    assert hows(summary) == {"a-001": first, "b-001": "finished"}
    assert begun(workers) == runs
    assert (first == "failed") == ("journal" in summary["items"][0]["why"])
    assert died == any("died" in line for line in said)


def test_what_was_cut_off_before_it_began_is_kept_aside_and_begun_anew(tmp_path):
    (tmp_path / "runs" / "a-001").mkdir(parents=True)
    (tmp_path / "runs" / "a-001" / "sequence.yaml").write_text("x")
    batch, workers = night(tmp_path, queue(("a", "")))
    assert batch.run()["how"] == "finished"
    assert begun(workers) == ["run a-001"]
    assert (tmp_path / "runs" / "a-001.unbegun-1" / "sequence.yaml").exists()


def test_a_folder_of_something_else_is_refused_and_stays_as_it_was(tmp_path):
    (tmp_path / "SHA256SUMS").write_text("of a sealed run")
    with pytest.raises(UsageError, match="it contains SHA256SUMS"):
        night(tmp_path, queue(("a", "")))[0].run()
    assert [path.name for path in tmp_path.iterdir()] == ["SHA256SUMS"]


def test_another_queue_is_refused_in_a_folder_that_has_one(tmp_path):
    night(tmp_path, queue(("a", "")))[0].run()
    with pytest.raises(RunFolderError, match="another queue"):
        night(tmp_path, queue(("b", "")))[0].run()


def test_the_queue_in_the_documents_is_one():
    document = (Path(__file__).parents[4] / "docs" / "batches.md").read_text(encoding="utf-8")
    example, *_ = re.findall(r"```yaml\n(.*?)```", document, re.DOTALL)
    shown = check_document(example.encode(), "example", Queue).value
    items = by_priority(items_of(shown.jobs, datetime(2026, 3, 1, tzinfo=UTC)))
    assert [item.key for item in items][:2] == ["first-001", "cam7-001"]


def test_a_queue_is_checked_with_all_it_names_before_anything_runs(tmp_path):
    path = tmp_path / "queue.yaml"
    text = "format: starbench/queue/1\nname: Night\njobs:\n" + JOB.format("a", "") + JOB.format("A", "")
    path.write_text(text)
    with pytest.raises(ScriptError, match="same name: A, a"):
        read_queue(path)
    path.write_text(text.replace("name: A, sequence: three_pose", "name: b, sequence: four_pose", 1))
    with pytest.raises(ScriptError, match="four_pose"):
        read_queue(path)


# ---------------------------------------------------------------- what counts as an attempt


@pytest.mark.parametrize(
    ("gaining", "begun_times", "how"),
    [({1, 2, 3}, 5, "died"), ({1, 2, 3, 4}, 6, "finished"), ({3}, 2, "died"), (set(), 2, "died")],
)
def test_attempts_are_those_in_a_row_that_brought_nothing(tmp_path, gaining, begun_times, how):
    """The run dies five times; some of its processes have recorded one more pose."""
    clock = VirtualClock(BEGIN)

    def record(run):
        pose = len(workers.begun)
        if pose in gaining:
            with Journal.open(run / "journal.jsonl", clock) as journal:
                journal.append(Event.CAPTURE_STORED, pose=pose, pose_name="p", attempt=1)
                journal.append(Event.ATTEMPT_CHECKED, pose=pose, attempt=1, accepted=True)

    jobs = queue(("a", ", attempts: 2"))
    batch, workers = night(tmp_path, jobs, *["died"] * 5, clock=clock, after=record)
    assert hows(batch.run()) == {"a-001": how}
    assert len(workers.begun) == begun_times


def test_power_cuts_use_up_no_attempt(tmp_path, monkeypatch):
    """Two cuts before the first pose and one failure were three attempts once, and the run was given up."""
    monkeypatch.setattr("bench.batch.batch.make_safe_after", lambda *_: [])
    jobs = queue(("a", ", attempts: 3"))
    for _ in range(2):
        cut_off(tmp_path, jobs)
    batch, workers = night(tmp_path, jobs, "failed", "hung")
    assert hows(batch.run()) == {"a-001": "finished"}
    assert len(workers.begun) == 3


# ---------------------------------------------------------------- what a batch finds that was cut off


def test_the_run_that_was_at_work_is_seen_to_before_another_is_begun(tmp_path, monkeypatch):
    jobs = queue(("a", ""), ("late", ', priority: 9, start_at: "20:05"'))
    top = check_document(jobs.text.replace(b"jobs:", b"zone: UTC\njobs:", 1), "queue.yaml", Queue)
    cut_off(tmp_path, top)
    clock, seen = VirtualClock(BEGIN), []
    clock.sleep(900.0)  # 20:15: the other one is due, and comes first
    monkeypatch.setattr("bench.batch.batch.adopt", lambda run, *_: seen.append(f"wait for {run.name}"))
    monkeypatch.setattr(
        "bench.batch.batch.make_safe_after", lambda run, *_: seen.append(f"make safe {run.name}") or []
    )
    batch, _ = night(tmp_path, top, clock=clock, before=lambda run: seen.append(run.name))
    assert batch.run()["how"] == "finished"
    assert seen[:3] == ["wait for a-001", "make safe a-001", "late-001"]
    assert seen[-1] == "a-001"


def test_the_status_of_an_interrupted_batch_ends_with_the_whole_command_that_continues_it(tmp_path):
    file = write_queue(tmp_path / "my night.yaml", "name: a, sequence: three_pose, station: simulated")
    night(tmp_path / "out", read_queue(file), Aborted("SIGTERM received"))[0].run()
    last = batch_status_text(read_batch_status(tmp_path / "out")).splitlines()[-1]
    assert last.endswith(f": starbench batch '{file}' --output {tmp_path / 'out'}")


def test_the_run_at_work_is_told_while_the_batch_runs_and_not_of_one_that_was_killed(tmp_path):
    seen, summaries, folder = [], [], tmp_path / "night"

    def look(run):
        seen.append(read_batch_status(folder))
        summaries.append(summarise(folder, read_batch(folder)))
        shutil.copytree(folder, tmp_path / f"killed-{run.name}")  # as a power cut leaves it

    night(folder, queue(("a", ""), ("b", "")), before=look)[0].run()
    assert [status.current_run for status in seen] == ["a-001: starting", "b-001: starting"]
    assert all(status.running for status in seen)
    killed = read_batch_status(tmp_path / "killed-b-001")
    assert [item["how"] for item in summaries[1]["items"]] == ["finished", "in progress"]
    assert "Runs without a result" not in render_batch(summaries[1])
    killed_items = summarise(tmp_path / "killed-b-001", read_batch(tmp_path / "killed-b-001"))["items"]
    assert [item["how"] for item in killed_items] == ["finished", "cut off"]
    assert (killed.running, killed.current_run) == (False, "")
    assert [run.item for run in killed.done] == ["a-001"]
    ended = read_batch_status(folder)
    assert (ended.running, ended.current_run, ended.ended) == (False, "", "finished")


# ---------------------------------------------------------------- the time of the system


class MovedClock(VirtualClock):
    """A clock that somebody sets, or whose computer sleeps or starts anew: one of its times goes on by so much."""

    set_by_s = moved_s = 0.0

    def utc_now(self):
        return super().utc_now() + timedelta(seconds=self.set_by_s)

    def monotonic(self):
        return super().monotonic() + self.moved_s


def runs_on_a_moved_clock(folder, jobs, **moved):
    """How many runs a batch begins whose clock moves during its first; that one is known to have taken 10 minutes."""
    clock = MovedClock(BEGIN)
    batch, workers = night(folder, jobs, clock=clock, after=lambda _: vars(clock).update(moved))
    batch.run()
    assert read_batch(folder).runs["a-001"].ended[0].duration_s == pytest.approx(600.0, abs=1.0)
    return len(workers.begun)


@pytest.mark.parametrize(
    ("set_by_s", "runs"),
    [(0.0, 4), (3600.0, 1), (1500.0, 2), (-3600.0, 4)],
    ids=["never", "asleep for an hour", "put forward", "put back"],
)
def test_no_run_is_begun_that_would_end_after_the_time_of_day(tmp_path, set_by_s, runs):
    """The clock moves during the first run, at 20:00; each takes 10 minutes, and nothing may end after 20:45."""
    jobs = queue(("a", ", times: 4"), top='zone: UTC\nstop_by: "20:45"\n')
    assert runs_on_a_moved_clock(tmp_path, jobs, set_by_s=set_by_s) == runs


@pytest.mark.parametrize("moved_s", [-5000.0, 5000.0])
def test_the_duration_of_a_run_does_not_depend_on_a_start_of_the_computer(tmp_path, moved_s):
    assert runs_on_a_moved_clock(tmp_path, queue(("a", "")), moved_s=moved_s) == 1

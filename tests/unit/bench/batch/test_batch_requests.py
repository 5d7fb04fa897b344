"""Jobs added to a batch and withdrawn from it: taken once, answered, kept over a restart, refused with a reason."""

import json
import threading
from datetime import UTC, datetime

import pytest
from locking_process import locking, suspend
from nights import BEGIN, begun, hows, job_words, night, queue
from waiting import wait_until

from bench.base.clock import VirtualClock
from bench.base.errors import RunFolderError, ScriptError
from bench.batch.batch_requests import REQUESTS, Request, answer_text, send_request
from bench.batch.batch_status import batch_status_text, read_batch_status
from bench.commands.status import tell
from bench.record.journal import read_journal


def leave(folder, request, number=0):
    """Put a request where a batch finds it, as ``send_request`` does."""
    (folder / REQUESTS).mkdir(parents=True, exist_ok=True)
    (folder / REQUESTS / f"{number:04d}-{request.id}.json").write_text(request.model_dump_json())


def add(name, **words):
    return Request(word="add", by="ada@lab", job=job_words(name, **words))


def withdraw(name):
    return Request(word="withdraw", by="ada@lab", name=name)


def leaves(folder, *requests):
    """What leaves requests while the first run is under way."""
    left = list(requests)

    def leave_all(_run):
        while left:
            leave(folder, left.pop(0), number=len(left))
        wait_until(lambda: not any((folder / REQUESTS).glob("*.json")), 20)

    return leave_all


def one_run(folder, **more):
    """A batch of one job, and its workers."""
    return night(folder, queue(("a", "")), **more)


def asked(folder):
    return [e.data for e in read_journal(folder / "journal.jsonl")[0] if e.event == "requested"]


def test_a_job_added_while_a_run_is_under_way_is_done_and_one_withdrawn_is_not(tmp_path):
    before = leaves(tmp_path, withdraw("b"), add("urgent", priority=9, times=2))
    batch, workers = night(tmp_path, queue(("a", ", times: 2"), ("b", "")), before=before)
    summary = batch.run()
    assert begun(workers) == ["run a-001", "run urgent-001", "run urgent-002", "run a-002"]
    assert hows(summary)["b-001"] == "withdrawn"
    assert summary["how"] == "finished"
    assert [(r["word"], r["job"], r["taken"]) for r in summary["requests"]] == [
        ("add", "urgent", True),
        ("withdraw", "b", True),
    ]


@pytest.mark.parametrize(
    ("request_", "why"),
    [
        (add("a"), "has or had a job a"),
        (add("A"), "the batch already has or had a job A"),
        (withdraw("c"), "no job c"),
        (withdraw("a"), "all runs of a have begun"),
        (add("x", sequence="no_such"), "no_such"),
    ],
    ids=["doubled", "doubled in capitals", "unknown", "nothing left", "no such sequence"],
)
def test_a_request_that_makes_no_sense_is_refused_with_its_reason(tmp_path, request_, why):
    summary = one_run(tmp_path, before=leaves(tmp_path, request_))[0].run()
    (answer,) = asked(tmp_path)
    assert not answer["taken"]
    assert why in answer["why"]
    assert list(hows(summary)) == ["a-001"]


def test_requests_left_while_no_process_works_are_taken_when_the_batch_goes_on(tmp_path):
    one_run(tmp_path)[0].run()
    request = add("late", times=2)
    assert send_request(tmp_path, request, patience_s=0.5) is None
    assert "when it continues" in answer_text(None)
    batch, workers = one_run(tmp_path)
    summary = batch.run()
    assert begun(workers) == ["run late-001", "run late-002"]
    assert not any((tmp_path / REQUESTS).iterdir())
    leave(tmp_path, request)  # the process died between its answer and the removal of the file
    assert one_run(tmp_path)[0].run()["items"] == summary["items"]
    assert len(asked(tmp_path)) == 1


def test_what_is_no_request_is_answered_and_removed(tmp_path):
    (tmp_path / REQUESTS / "stray" / "deep").mkdir(parents=True)
    (tmp_path / REQUESTS / "0-x.json").write_bytes(b"{")
    (tmp_path / REQUESTS / "1-big.json").write_bytes(b" " * 100_000)
    one_run(tmp_path)[0].run()
    assert [(a["word"], a["taken"]) for a in asked(tmp_path)] == [("unknown", False)] * 3
    assert not any((tmp_path / REQUESTS).iterdir())


def test_a_job_added_at_midnight_counts_its_repetitions_from_then(tmp_path):
    clock, leave_all = VirtualClock(BEGIN), leaves(tmp_path, add("late", times=2, every_min=60))

    def at_midnight(run):
        clock.sleep(4 * 3600.0 - clock.monotonic())
        leave_all(run)

    batch, workers = one_run(tmp_path, clock=clock, before=at_midnight)
    batch.run()
    times_h = [at_s / 3600 for _, _, at_s in workers.begun]
    assert times_h == pytest.approx([4, 4 + 600 / 3600, 5], abs=2e-3)


def test_the_answer_is_waited_for_where_a_process_works_on_the_batch(tmp_path):
    """The sender's side, with the batch in a thread."""
    gate, answers = threading.Event(), []

    batch, _ = one_run(tmp_path, before=lambda _: gate.wait(30))
    thread = threading.Thread(target=batch.run)
    thread.start()
    try:
        wait_until((tmp_path / "journal.jsonl").exists, 20)
        answers.append(send_request(tmp_path, add("b")))
    finally:
        gate.set()
        thread.join()
    assert answers[0]["taken"]
    assert answer_text(answers[0]).startswith("Accepted: b")


def test_a_faulty_job_file_is_refused_before_anything_is_asked(tmp_path):
    path = tmp_path / "job.yaml"
    path.write_text("format: starbench/job/1\nname: a\nsequence: no_such\nstation: simulated\n")
    with pytest.raises(ScriptError, match="no_such"):
        tell.callback(tmp_path, "add", str(path), "ada", take_over=False)


@pytest.mark.parametrize("words", [{"word": "add"}, {"word": "withdraw"}, {"word": "add", "name": "a"}])
def test_a_request_carries_what_its_word_needs(words):
    with pytest.raises(ValueError, match="add needs a job"):
        Request(by="ada", **words)


# ---------------------------------------------------------------- how a batch stands


def test_the_status_tells_what_is_done_and_when_the_rest_comes(tmp_path):
    clock, looks = VirtualClock(BEGIN), []

    def look(_run):
        looks.append(read_batch_status(tmp_path, clock.utc_now))

    jobs = queue(("a", ", times: 3, every_min: 30"), top="zone: UTC\nstop_by: '20:50'\n")
    night(tmp_path, jobs, clock=clock, before=look)[0].run()
    first, second = looks
    assert first.running
    assert [run.item for run in first.upcoming] == ["a-001", "a-002", "a-003"]
    assert first.upcoming[2].begin is None
    assert [run.how for run in second.done] == ["finished"]
    assert second.upcoming[0].begin == datetime(2026, 3, 1, 20, 30, tzinfo=UTC)
    took = second.upcoming[0].end - second.upcoming[0].begin
    assert took.total_seconds() == pytest.approx(600, abs=0.1)  # as the first took, not as planned
    text = batch_status_text(second)
    assert "No time for: a-003" in text
    assert "Expected end: Sun 20:40 UTC" in text
    ended = read_batch_status(tmp_path, clock.utc_now)
    assert (ended.running, ended.ended) == (False, "stopped")
    assert json.loads(json.dumps(ended.to_dict()))["coming"] == []


def test_a_batch_whose_process_is_suspended_is_told_as_such_and_how_it_continues(tmp_path):
    clock = VirtualClock(BEGIN)
    night(tmp_path, queue(("a", ", times: 2")), clock=clock)[0].run()
    with locking(tmp_path) as process:
        suspend(process)
        assert f"kill -CONT {process.pid}" in batch_status_text(read_batch_status(tmp_path, clock.utc_now))


def test_a_request_that_cannot_be_judged_is_refused_and_ends_no_night(tmp_path, monkeypatch):
    def broken(_job):
        raise ZeroDivisionError("nobody foresaw this")

    monkeypatch.setattr("bench.batch.batch_requests.job_faults", broken)
    leave(tmp_path, add("b"))
    assert one_run(tmp_path)[0].run()["how"] == "finished"
    assert asked(tmp_path)[0]["why"].endswith("ZeroDivisionError: nobody foresaw this")


def test_a_rehearsal_does_not_say_that_it_continues_before_it_is_refused(tmp_path):
    one_run(tmp_path, rehearsal=True)[0].run()
    lines = []
    with pytest.raises(RunFolderError, match="in the same folder"):
        one_run(tmp_path, say=lines.append)[0].run()
    assert lines == []

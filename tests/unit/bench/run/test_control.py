"""Commands of operators: who may give them, why they are refused, and that each is done once and removed."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from journals import CLOCK

from bench.base.clock import Aborted, BenchClock
from bench.base.errors import RunFolderError, StorageError
from bench.record import inbox as inbox_module
from bench.record.events import Entering, Event
from bench.record.folder_lock import is_locked
from bench.record.history import Attempt, History, replay
from bench.record.journal import Journal, read_journal
from bench.record.run_folder import RunFolder
from bench.record.run_log import RunLog
from bench.run.control import CONTROL, Command, CommandInbox, refusal, send

POSES = {1: "left", 2: "right", 3: "below"}


def command(word, by="ada", **more):
    return Command(word=word, by=by, **more)


def accepted(pose):
    return Attempt(pose, POSES[pose], 1, {}, {"accepted": True})


# ---------------------------------------------------------------- who may

HELD = History(holder="ada")
AT_POSES = History(to_skip={2: "ada"})
AT_POSES.add(accepted(1))
TAKEN_UP = {"take_over": True}
ANSWERED = History(question="Cap off?", answer=("abort", "ada"))


@pytest.mark.parametrize(
    ("word", "more", "history", "why"),
    [
        ("release", {}, HELD, "the run is held by ada"),
        ("skip", {"pose": 1}, HELD, "the run is held by ada"),
        ("release", {"by": "ada"}, HELD, ""),
        ("hold", TAKEN_UP, HELD, ""),
        ("abort", {}, HELD, ""),
        ("release", {}, History(), "no operator holds the run"),
        ("skip", {}, AT_POSES, "no pose is at work"),
        ("skip", {"pose": 4}, AT_POSES, "no pose 4; the poses are 1 to 3"),
        ("skip", {"pose": 1}, AT_POSES, "already recorded"),
        ("skip", {"pose": 2}, AT_POSES, "already skipped"),
        ("answer", {"answer": "continue"}, History(), "the run asks no question"),
        ("answer", {"answer": "continue"}, History(question="Cap off?"), ""),
        ("answer", {"answer": "continue"}, ANSWERED, "the run asks no question"),
    ],
)
def test_a_command_that_a_person_may_not_give_now_is_refused_with_the_reason(word, more, history, why):
    reason = refusal(command(word, **{"by": "ben", **more}), history, POSES)
    assert why in reason
    assert bool(reason) == bool(why)


# ---------------------------------------------------------------- what a journal of commands amounts to


def commanded(journal, word, taken=True, **more):
    journal.append(Event.COMMANDED, id="x", word=word, by="ada", taken=taken, why="", **more)


def test_holds_last_from_hold_to_release_and_not_beyond_the_process(tmp_path):
    with Journal.create(tmp_path / "j", CLOCK) as journal:
        commanded(journal, "hold", taken=False)
        assert replay(journal.entries).holder == ""
        commanded(journal, "hold")
        assert replay(journal.entries).holder == "ada"
        commanded(journal, "release")
        assert replay(journal.entries).holder == ""
        commanded(journal, "hold")
        commanded(journal, "skip", pose=2)
        journal.append(Event.RUN_RESUMED)
        assert replay(journal.entries).holder == ""
        assert replay(journal.entries).to_skip == {2: "ada"}


# ---------------------------------------------------------------- the inbox


@pytest.fixture
def run(tmp_path):
    """A run folder held by this process, its log, and its clock."""
    folder = RunFolder.create(tmp_path / "run")
    with folder, Journal.create(folder.journal_path, CLOCK) as journal:
        yield folder.path, RunLog(journal), BenchClock()


def answers(folder):
    return [dict(e.data) for e in read_journal(folder / "journal.jsonl")[0] if e.event == "commanded"]


def test_a_command_is_answered_in_the_journal_and_its_file_removed(run):
    folder, log, clock = run
    with CommandInbox(folder, log, POSES, clock):
        answer = send(folder, command("hold"))
        assert (answer["taken"], answer["by"]) == (True, "ada")
        with log.held() as history:
            assert history.holder == "ada"
        refused = send(folder, command("release", by="ben"))
        assert not refused["taken"]
        assert "held by ada" in refused["why"]
        assert send(folder, command("release", by="ben", take_over=True))["taken"]
    assert not (folder / CONTROL).exists()
    assert [a["word"] for a in answers(folder)] == ["hold", "release", "release"]


def test_an_abort_ends_the_wait_of_the_run_at_once(run):
    folder, log, clock = run
    with CommandInbox(folder, log, POSES, clock):
        sender = threading.Thread(target=send, args=(folder, command("abort")))
        sender.start()
        with pytest.raises(Aborted, match="abort by ada"):
            clock.sleep(60)
        sender.join()


def test_skip_applies_to_the_current_pose_unless_another_is_named(run):
    folder, log, clock = run
    with CommandInbox(folder, log, POSES, clock):
        log.write(Entering, state="recording", pose=2)
        assert send(folder, command("skip"))["pose"] == 2
        assert send(folder, command("skip", pose=3))["pose"] == 3
    assert set(log.history.to_skip) == {2, 3}


def test_a_command_to_a_dead_process_is_answered_and_not_done(run):
    folder, log, clock = run
    (folder / CONTROL).mkdir()
    (folder / CONTROL / "1.json").write_text(command("abort").model_dump_json())
    with CommandInbox(folder, log, POSES, clock):
        clock.check()
    (answer,) = answers(folder)
    assert not answer["taken"]
    assert "has died" in answer["why"]


@pytest.mark.timeout(60)
def test_a_file_that_is_not_a_command_is_reported_and_removed(run):
    folder, log, clock = run
    with CommandInbox(folder, log, POSES, clock):
        path = folder / CONTROL / "a.json"
        path.write_text('{"word": "explode", "by": "ada"}')
        while path.exists():
            clock.sleep(0.02)
    assert [a["why"] for a in answers(folder)] == ["it is not a command"]


def test_an_answer_that_cannot_be_journaled_fails_the_run_and_is_not_an_abort(run):
    folder, log, clock = run
    inbox = CommandInbox(folder, log, POSES, clock).open()
    log.journal.close()
    with pytest.raises(RunFolderError, match="did not answer"):
        send(folder, command("hold"), patience_s=0.5)
    with pytest.raises(StorageError):
        clock.check()
    inbox.close()


def test_an_error_of_the_watching_thread_ends_the_run(run):
    folder, log, clock = run

    def broken():
        raise ZeroDivisionError("a door with no hinge")

    with CommandInbox(folder, log, POSES, clock, (broken,)), pytest.raises(ZeroDivisionError, match="hinge"):
        clock.sleep(20)


def test_a_command_to_a_run_that_is_ending_is_refused_as_too_late(run, monkeypatch):
    folder, log, clock = run
    write = inbox_module.write_atomic

    def too_late(path, data):
        inbox.close()
        write(path, data)

    monkeypatch.setattr(inbox_module, "write_atomic", too_late)
    with CommandInbox(folder, log, POSES, clock) as inbox, pytest.raises(RunFolderError, match="is ending"):
        send(folder, command("hold"))


def test_testing_the_lock_of_a_run_does_not_block_others(tmp_path):
    RunFolder.create(tmp_path / "run").close()

    def ask():
        while not made:
            is_locked(tmp_path / "run")

    made = []
    with ThreadPoolExecutor(1) as pool:
        pool.submit(ask)
        try:
            for _ in range(20):
                RunFolder.create(tmp_path / "run").close()
        finally:
            made.append(20)
    assert not is_locked(tmp_path / "run")

"""The panel's pages and streams: what they tell, that nothing is lost, and how commands reach a run."""

import json
import threading
import time
from contextlib import contextmanager

import httpx
import pytest
from journals import MadeRun, at_work
from pages import served
from waiting import wait_until

from bench.base.clock import Aborted
from bench.extras.pages.panel.panel_app import Panel, panel_app
from bench.extras.pages.web.token import PageToken
from bench.record.events import Asked
from bench.record.journal import read_journal

PATIENCE_S = 20.0


class Stream:
    """The messages of a stream, as a page receives them."""

    def __init__(self, answer):
        self._lines = answer.iter_lines()
        self.id = ""

    def next(self):
        """The data of the next message named update."""
        event = "message"
        for line in self._lines:
            if line.startswith("id: "):
                self.id = line[4:]
            elif line.startswith("event: "):
                event = line[7:]
            elif line.startswith("data: ") and event == "update":
                return json.loads(line[6:])
            elif not line:
                event = "message"
        raise AssertionError("the stream has ended")

    def until(self, holds):
        """Messages up to the first that meets a condition."""
        messages = []
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            messages.append(self.next())
            if holds(messages[-1]):
                return messages
        raise AssertionError(f"it never came: {messages[-1]}")


@contextmanager
def streamed(server, path, after=None):
    headers = {} if after is None else {"Last-Event-ID": str(after)}
    with httpx.stream("GET", f"{server.url}{path}", headers=headers, timeout=PATIENCE_S) as answer:
        assert answer.status_code == 200
        yield Stream(answer)


@pytest.fixture
def server(run):
    with served(panel_app(run.folder.parent)) as server:
        yield server


def test_no_page_names_another_host():
    from bench.extras.pages.panel.panel_app import ASSETS
    from bench.extras.pages.web.pages import ASSETS as SHARED

    for path in [*ASSETS.iterdir(), *SHARED.iterdir()]:
        text = path.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
        assert "http://" not in text, path
        assert "https://" not in text, path
        assert "innerHTML" not in text, path  # text of a journal must never become markup


def test_a_run_is_told_and_then_what_is_new(run, server):
    with streamed(server, "api/run/run7/events") as stream:
        first = stream.until(lambda m: m["head"]["accepted"] == 1)[-1]
        assert [row["state"] for row in first["rows"]] == ["accepted", "planned", "planned"]
        line = first["line"]
        assert int(stream.id) == line
        run.record(2)
        later = stream.until(lambda m: m["head"]["accepted"] == 2)
        assert not any(message["reset"] for message in later)
        assert later[0]["since"] == line
        assert {row["number"] for message in later for row in message["rows"]} == {2}


def test_a_reader_that_comes_back_misses_nothing_and_gets_nothing_twice(run, server):
    with streamed(server, "api/run/run7/events") as stream:
        first = stream.until(lambda m: m["head"]["accepted"] == 1)[-1]
    run.record(2)
    run.record(3, accepted=False)
    with streamed(server, "api/run/run7/events", after=first["line"]) as stream:
        later = stream.until(lambda m: m["head"]["recordings"] == 3)
        assert not any(message["reset"] for message in later)
        lines = [entry["line"] for message in later for entry in message["log"]]
        assert lines == sorted(set(lines))
        assert min(lines) == first["line"] + 1
        assert {row["number"] for message in later for row in message["rows"]} == {2, 3}


def test_a_page_of_another_run_or_a_longer_journal_is_told_everything(run, server):
    with streamed(server, "api/run/run7/events", after=100_000) as stream:
        assert stream.next()["reset"]


def test_the_end_of_a_process_is_told_although_the_journal_is_silent(run, server):
    with at_work(run), streamed(server, "api/run/run7/events") as stream:
        assert stream.until(lambda m: m["head"]["running"])[-1]["head"]["verdict"] == "running"
    with streamed(server, "api/run/run7/events") as stream:
        assert stream.until(lambda m: not m["head"]["running"])[-1]["head"]["verdict"] == "interrupted"


def test_a_log_is_told_backwards(run, server):
    log = httpx.get(f"{server.url}api/run/run7/log?before=4").json()["log"]
    assert [entry["line"] for entry in log] == [1, 2]
    assert httpx.get(f"{server.url}api/run/run7/log?before=x").status_code == 400


def test_an_address_of_no_run_is_one_clear_error(server):
    for path in (
        "api/run/nowhere/events",
        "api/run/..%2F..%2Fetc/state",
        "api/batch/run7/events",
        "report/run7",
    ):
        answer = httpx.get(f"{server.url}{path}")
        assert answer.status_code == 404
        assert set(answer.json()["error"]) == {"kind", "what", "where", "remedy", "message"}


def test_the_list_tells_a_new_run(run, server):
    with streamed(server, "api/list") as stream:
        assert [row["key"] for row in stream.next()["runs"]] == ["run7"]
        MadeRun(run.folder.parent / "run8").begin()
        changed = stream.until(lambda m: m["runs"] and m["runs"][0]["key"] == "run8")[-1]
        assert [row["key"] for row in changed["runs"]] == ["run8"]  # what did not change is not told again
        assert not changed["reset"]
        assert changed["gone"] == []
    whole = httpx.get(f"{server.url}api/list/state").json()
    assert whole["reset"]
    assert {row["key"] for row in whole["runs"]} == {"run7", "run8"}


# ---------------------------------------------------------------- commands


def _post(server, body, **headers):
    origin = {"Origin": server.url.rstrip("/")}
    return httpx.post(
        f"{server.url}api/run/run7/command", json=body, headers={**origin, **headers}, timeout=PATIENCE_S
    )


def test_a_hold_and_a_release_reach_the_run_with_the_name(run, server):
    with at_work(run):
        held = _post(server, {"word": "hold", "by": "Ada"}).json()
        assert (held["taken"], held["text"][:8]) == (True, "Accepted")
        refused = _post(server, {"word": "release", "by": "Ben"}).json()
        assert not refused["taken"]
        assert "held by Ada" in refused["text"]
        assert _post(server, {"word": "release", "by": "Ben", "take_over": True}).json()["taken"]
        skipped = _post(server, {"word": "skip", "pose": 3, "by": "Ada"}).json()
        assert skipped["text"] == "Accepted: pose 3 is skipped."
    commands = [entry.data for entry in read_journal(run.path)[0] if entry.event == "commanded"]
    assert [(command["word"], command["by"], command["taken"]) for command in commands] == [
        ("hold", "Ada", True),
        ("release", "Ben", False),
        ("release", "Ben", True),
        ("skip", "Ada", True),
    ]


def test_the_journal_says_whether_the_sender_had_the_token(run):
    for token, known_by in ((None, "typed"), (PageToken("0123456789abcdef"), "token")):
        signed = {"Authorization": f"Bearer {token.text}"} if token is not None else {}
        with served(panel_app(run.folder.parent), token=token) as server, at_work(run):
            assert _post(server, {"word": "hold", "by": "Ada"}, **signed).json()["taken"]
        newest = [entry.data for entry in read_journal(run.path)[0] if entry.event == "commanded"][-1]
        assert (newest["by"], newest["known_by"]) == ("Ada", known_by)


def test_a_link_out_of_the_folder_is_not_followed_and_named(run, server, tmp_path):
    outside = MadeRun(tmp_path / "elsewhere" / "secret").begin()
    outside.record_all().end()
    (outside.folder / "report.html").write_text("<p>a report</p>")
    root = run.folder.parent
    (root / "away").symlink_to(outside.folder)
    (root / "alias").symlink_to(run.folder)
    (run.folder / "report.html").symlink_to(outside.folder / "report.html")
    for path in ("report/away", "api/run/away/state", "report/run7", "api/run/away/log?before=9"):
        answer = httpx.get(f"{server.url}{path}")
        assert answer.status_code == 404, path
        assert "leads out" in answer.json()["error"]["what"]
    assert httpx.get(f"{server.url}api/run/alias/state").status_code == 200
    listed = httpx.get(f"{server.url}api/list/state").json()
    assert {row["key"] for row in listed["runs"]} == {"run7", "alias"}
    assert any("away" in fault and "leads out" in fault for fault in listed["faults"])


def test_an_abort_needs_two_steps(run, server):
    with at_work(run) as (_, clock):
        answer = _post(server, {"word": "abort", "by": "Ada"})
        assert answer.status_code == 400
        assert "must be confirmed" in answer.json()["error"]["what"]
        clock.check()
        assert _post(server, {"word": "abort", "by": "Ada", "confirm": "abort"}).json()["taken"]
        with pytest.raises(Aborted, match="abort by Ada"):
            clock.sleep(5.0)  # the answer may be here before the clock has been told


def test_a_question_is_answered(run, server):
    with at_work(run) as (log, _):
        log.write(Asked, step=1, text="Is it dark?", default="abort", timeout_s=60.0)
        with streamed(server, "api/run/run7/events") as stream:
            asked = stream.until(lambda m: m["head"]["question"])[-1]["head"]
            assert asked["question"]["text"] == "Is it dark?"
            assert asked["can"]["answer"]
            assert _post(server, {"word": "answer", "answer": "continue", "by": "Ada"}).json()["taken"]
            assert stream.until(lambda m: not m["head"]["can"]["answer"])
        # The page may have read the journal before its writer has told itself.
        wait_until(lambda: log.history.answer == ("continue", "Ada"))


@pytest.mark.parametrize(
    ("body", "what"),
    [
        ({"word": "hold"}, "who gives it"),
        ({"word": "explode", "by": "Ada"}, "not a command"),
        ({"word": "hold", "by": "Ada", "folder": "/etc"}, "not a command"),
        ({"word": "hold", "by": "Ada", "known_by": "file mode"}, "not a command"),
        ([], "not a JSON object"),
    ],
)
def test_what_is_no_command_is_refused_and_never_reaches_the_run(run, server, body, what):
    with at_work(run):
        answer = _post(server, body)
        assert answer.status_code == 400
        assert what in answer.json()["error"]["what"]
    assert not any(entry.event == "commanded" for entry in read_journal(run.path)[0])


def test_a_command_to_a_run_without_a_process_is_one_clear_error(server):
    answer = _post(server, {"word": "hold", "by": "Ada"})
    assert answer.status_code == 404
    assert answer.json()["error"]["what"].startswith("No process")


def test_the_panel_writes_nothing_but_commands(run, server):
    run.record_all().end()
    run.folder.chmod(0o555)
    before = {path: path.stat().st_mtime_ns for path in run.folder.rglob("*")}
    try:
        with streamed(server, "api/run/run7/events") as stream:
            stream.until(lambda m: m["head"]["ended"] == "finished")
        httpx.get(f"{server.url}api/run/run7/state", timeout=PATIENCE_S)
    finally:
        run.folder.chmod(0o755)
    assert {path: path.stat().st_mtime_ns for path in run.folder.rglob("*")} == before


def test_no_thread_and_no_process_remains(run, children):
    before = set(threading.enumerate())
    panel = Panel(run.folder.parent)
    with served(panel.app()) as server, streamed(server, "api/run/run7/events") as stream:
        stream.next()
    left = {thread for thread in set(threading.enumerate()) - before if thread.name == "journals"}
    assert not left
    assert all(child.poll() is not None for child in children)

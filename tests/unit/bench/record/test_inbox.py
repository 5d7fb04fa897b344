"""Inboxes: messages are answered once, in their order, and anything else in the folder does no harm."""

import os
import threading

import pytest
from pydantic import BaseModel

from bench.base.errors import StorageError
from bench.record.inbox import Inbox, Poller


class Note(BaseModel):
    text: str


@pytest.fixture
def inbox(tmp_path):
    (tmp_path / "inbox").mkdir()
    return Inbox(tmp_path / "inbox", Note, 100, ignored=frozenset({".heartbeat"}))


def drained(inbox):
    notes = []
    inbox.drain(lambda note, name: notes.append((note.text if note else None, name)))
    return notes


def test_messages_are_answered_in_the_order_of_sending_and_removed(inbox):
    sent = [inbox.drop(Note(text=text), id_) for text, id_ in (("first", "b"), ("second", "a"))]
    assert drained(inbox) == [("first", sent[0].name), ("second", sent[1].name)]
    assert drained(inbox) == []
    assert list(inbox.folder.iterdir()) == []


def test_a_message_that_could_not_be_answered_stays(inbox):
    path = inbox.drop(Note(text="x"), "a")

    def fail(_note, _name):
        raise StorageError("The disk is full.")

    with pytest.raises(StorageError):
        inbox.drain(fail)
    assert path.exists()
    assert drained(inbox) == [("x", path.name)]


def test_anything_else_is_answered_as_none_and_removed_and_what_is_ignored_stays(inbox):
    (inbox.folder / "a.json").write_text('{"words": 1}')
    (inbox.folder / "b.json").write_text('{"text": "' + "x" * 100 + '"}')
    (inbox.folder / "c").mkdir()
    os.mkfifo(inbox.folder / "d")
    (inbox.folder / "e").symlink_to("/dev/zero")
    (inbox.folder / ".heartbeat").write_text("1 2 3")
    (inbox.folder / ".f.json.tmp").write_text("half a mess")
    assert drained(inbox) == [(None, name) for name in ("a.json", "b.json", "c", "d", "e")]
    assert {path.name for path in inbox.folder.iterdir()} == {".heartbeat", ".f.json.tmp"}


def test_a_poller_calls_until_it_is_closed_and_passes_on_an_error_once():
    calls, errors, called, refused = [], [], threading.Event(), threading.Event()

    def look():
        calls.append(1)
        called.set()

    def fail():
        raise ValueError("broken")

    poller = Poller(look, errors.append, name="test", period_s=0.001)
    poller.start()
    assert called.wait(10)
    poller.close()
    count = len(calls)
    assert poller.closed
    assert not errors
    failing = Poller(fail, lambda error: (errors.append(error), refused.set()), name="test", period_s=0.001)
    failing.start()
    assert refused.wait(10)
    failing.close()
    assert [str(error) for error in errors] == ["broken"]
    assert len(calls) == count

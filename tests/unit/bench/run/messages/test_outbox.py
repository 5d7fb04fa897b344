"""The outbox: nothing lost, nothing delivered twice but by a process that was killed, nothing tried for ever."""

import subprocess
import sys
from datetime import UTC, datetime, timedelta

import pytest

from bench.base.errors import StorageError
from bench.run.messages.outbox import CLAIM, GIVEN_UP_AFTER, DeliveryFailed, Message, Outbox
from bench.stations.messages_section import AppriseConfig, MailConfig

NOW = datetime(2026, 3, 1, 20, 0, tzinfo=UTC)
MAIL = MailConfig(host="mail", sender="b@lab.example", to=("a@lab.example",))
CHAT = AppriseConfig(url_env="CHAT")


def message(key="k1", utc=NOW):
    return Message(key, "end", f"run {key}", "text", "run", "/runs/run", utc.isoformat())


@pytest.fixture
def outbox(tmp_path):
    return Outbox(tmp_path / "home")


class Receiver:
    """Takes messages, but for those tries that are told to fail."""

    def __init__(self, failures=0):
        self.taken, self.failures = [], failures

    def __call__(self, message, channel):
        if self.failures:
            self.failures -= 1
            raise DeliveryFailed("no network")
        self.taken.append((message.key, channel))


def deliver(outbox, send, now=NOW, **words):
    """Deliver at a moment; return how many are not sent after that."""
    outbox.deliver(send, lambda: now, **words)
    return outbox.unsent()


def only(outbox):
    ((state, delivery),) = outbox.deliveries()
    return state, delivery


def test_what_does_not_go_through_is_tried_again_for_a_week_then_given_up_but_for_who_asks(outbox):
    outbox.put(message(), [MAIL])
    receiver = Receiver(failures=3)
    for age in (timedelta(), GIVEN_UP_AFTER - timedelta(hours=1)):
        assert deliver(outbox, receiver, NOW + age) == 1
        assert only(outbox)[0] == "waiting"
    late = NOW + GIVEN_UP_AFTER
    for _ in range(2):  # the second time it is left alone
        assert deliver(outbox, receiver, late) == 1
        state, delivery = only(outbox)
        assert (state, delivery.tries, delivery.last_error) == ("failed", 3, "no network")
    assert deliver(outbox, receiver, late, by_hand=True) == 0
    state, delivery = only(outbox)
    assert (receiver.taken, state, delivery.last_error) == ([("k1", MAIL)], "sent", "")


def test_a_channel_that_is_down_holds_up_no_other(outbox):
    for minute, key in enumerate(("k1", "k2")):
        outbox.put(message(key, NOW + timedelta(minutes=minute)), [CHAT, MAIL])
    receiver, tried = Receiver(), []

    def send(message, channel):
        if channel == CHAT:
            tried.append(message.key)
            raise DeliveryFailed("timed out")
        receiver(message, channel)

    assert deliver(outbox, send) == 2
    assert receiver.taken == [("k1", MAIL), ("k2", MAIL)]
    assert tried == ["k1"]  # the next one waits for the next round, and goes first then
    deliver(outbox, send, NOW + timedelta(minutes=1))
    assert tried == ["k1", "k2"]


@pytest.mark.parametrize("later", [NOW + CLAIM, NOW - CLAIM])  # the system's time may be set back
def test_a_process_killed_while_sending_loses_nothing(outbox, later):
    outbox.put(message(), [MAIL])
    code = (
        "import os, sys; from datetime import UTC, datetime; from pathlib import Path; from bench.run.messages.outbox import Outbox\n"
        f"now = datetime.fromisoformat({NOW.isoformat()!r})\n"
        "Outbox(Path(sys.argv[1])).deliver(lambda *_: os.kill(os.getpid(), 9), lambda: now)"
    )
    assert subprocess.run([sys.executable, "-c", code, outbox.folder.parent], check=False).returncode == -9
    receiver = Receiver()
    assert deliver(outbox, receiver, NOW + CLAIM - timedelta(seconds=1), by_hand=True) == 1
    assert (receiver.taken, only(outbox)[0]) == ([], "sending")
    assert deliver(outbox, receiver, later) == 0
    assert receiver.taken == [("k1", MAIL)]
    assert only(outbox)[1].perhaps_twice


def test_of_two_processes_that_deliver_at_once_one_stands_back(outbox):
    outbox.put(message(), [MAIL])
    other, inner = Receiver(), []

    def send(*_):
        inner.append(deliver(outbox, other, by_hand=True))

    assert deliver(outbox, send) == 0
    assert inner == [1]
    assert other.taken == []
    assert not only(outbox)[1].perhaps_twice


def test_two_processes_that_saw_the_same_file_do_not_both_send_it(outbox, monkeypatch):
    """The other one claims it between this one's look and its claim."""
    outbox.put(message(), [MAIL])
    seen, other, mine = outbox.due(NOW, by_hand=False), Receiver(), Receiver()
    deliver(outbox, other)
    monkeypatch.setattr(outbox, "due", lambda *_, **__: seen)
    assert deliver(outbox, mine) == 0
    assert (len(other.taken), mine.taken) == (1, [])


def test_a_sender_that_outlived_its_claim_does_not_undo_what_another_one_did(outbox):
    outbox.put(message(), [MAIL])
    other = Receiver()

    def slow(*_):
        deliver(outbox, other, NOW + CLAIM)
        raise DeliveryFailed("timed out")

    assert deliver(outbox, slow) == 0
    assert other.taken == [("k1", MAIL)]
    state, delivery = only(outbox)
    assert (state, delivery.perhaps_twice) == ("sent", True)


def test_an_outbox_that_cannot_be_written_says_so(outbox):
    outbox.folder.parent.mkdir()
    outbox.folder.touch()
    with pytest.raises(StorageError) as refused:
        outbox.put(message(), [MAIL])
    assert str(outbox.folder) in str(refused.value)


def test_a_damaged_file_is_named_and_holds_up_no_other(outbox):
    outbox.put(message(), [MAIL])
    damaged = outbox.folder / "x.waiting"
    damaged.write_bytes(b'{"message": ')
    (outbox.folder / "notes.txt").touch()
    receiver = Receiver()
    assert deliver(outbox, receiver) == 1
    assert receiver.taken == [("k1", MAIL)]
    with pytest.raises(StorageError) as refused:
        outbox.deliveries()
    assert str(damaged) in str(refused.value)

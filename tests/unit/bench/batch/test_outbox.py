"""Outbox and courier: nothing lost, nothing made twice, no run waits for a server."""

import subprocess
import sys
import threading
import time
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from waiting import wait_until

from bench.base.clock import VirtualClock
from bench.base.errors import StorageError
from bench.batch.messages import LONGEST_PAUSE_S, Courier, DeliveryFailed, Message, Outbox
from bench.stations.messages_section import MessagesConfig, WebhookConfig

NOW = datetime(2026, 3, 1, 20, 0, tzinfo=UTC)


def message(key="k1", utc=NOW):
    return Message(key, "end", f"run {key}", "text", "run", "/runs/run", utc.isoformat())


@pytest.fixture
def outbox(tmp_path):
    return Outbox(tmp_path / "home")


class Receiver:
    """Takes messages, but for those tries that are told to fail."""

    def __init__(self, failures=0, error=None):
        self.taken, self.failures, self.error = [], failures, error or DeliveryFailed("no network")

    def __call__(self, message, channel):
        if self.failures:
            self.failures -= 1
            raise self.error
        self.taken.append((message.key, channel))


def test_an_empty_outbox_leaves_no_file(outbox):
    assert outbox.deliver(Receiver(), NOW) == 0
    assert outbox.deliveries() == []
    assert not outbox.path.exists()


def test_what_does_not_go_through_is_tried_again_ever_more_seldom(outbox):
    outbox.put(message(), ["mail"])
    receiver, at = Receiver(failures=100), NOW
    outbox.deliver(receiver, at)
    for pause_s in (5.0, 10.0, 20.0, *[None] * 8, LONGEST_PAUSE_S):
        if pause_s is None:
            outbox.deliver(receiver, at, all_waiting=True)
            continue
        failures = receiver.failures
        assert outbox.deliver(receiver, at + timedelta(seconds=pause_s - 0.1)) == 1
        assert receiver.failures == failures
        at += timedelta(seconds=pause_s)
        assert outbox.deliver(receiver, at) == 1
        assert receiver.failures == failures - 1
    assert outbox.deliveries()[0].last_error == "no network"
    receiver.failures = 0
    assert outbox.deliver(receiver, at, all_waiting=True) == 0
    assert outbox.deliveries()[0].last_error == ""


def test_a_system_time_that_was_set_back_keeps_no_message(outbox):
    outbox.put(message(), ["mail"])
    receiver = Receiver(failures=1)
    outbox.deliver(receiver, NOW)
    assert outbox.deliver(receiver, NOW - timedelta(hours=5)) == 0
    assert len(receiver.taken) == 1


def test_a_channel_that_hangs_is_given_up_and_holds_up_no_other(outbox, monkeypatch):
    monkeypatch.setattr("bench.batch.messages.DEADLINE_S", 0.3)
    for key in ("k1", "k2"):
        outbox.put(message(key), ["hangs", "up"])
    receiver, tried, over, order = Receiver(), [], threading.Event(), []

    def send(message, channel):
        order.append(channel)
        if channel == "hangs":
            tried.append(message.key)
            over.wait(10)
        else:
            receiver(message, channel)

    begun = time.monotonic()
    assert outbox.deliver(send, NOW) == 2
    assert time.monotonic() - begun < 5
    over.set()
    assert receiver.taken == [("k1", "up"), ("k2", "up")]
    assert tried == ["k1"]  # the next one waits for the next round
    deliveries = {(d.message.key, d.channel): d for d in outbox.deliveries()}
    assert deliveries["k1", "hangs"].perhaps_twice
    assert "not complete within 0.3 s" in deliveries["k1", "hangs"].last_error


def test_a_process_killed_while_sending_loses_nothing(outbox):
    outbox.put(message(), ["mail"])
    code = (
        "import os, sys; from datetime import UTC, datetime; from pathlib import Path; from bench.batch.messages import Outbox\n"
        "Outbox(Path(sys.argv[1])).deliver(lambda *_: os.kill(os.getpid(), 9), datetime.now(UTC), all_waiting=True)"
    )
    assert subprocess.run([sys.executable, "-c", code, outbox.path.parent], check=False).returncode == -9
    receiver = Receiver()
    assert outbox.deliver(receiver, NOW) == 0
    assert receiver.taken == [("k1", "mail")]
    assert outbox.deliveries()[0].perhaps_twice


def test_of_two_processes_that_deliver_at_once_one_stands_back(outbox):
    outbox.put(message(), ["mail"])
    other = Receiver()
    inner = []

    def send(*_):
        inner.append(outbox.deliver(other, NOW))

    assert outbox.deliver(send, NOW) == 0
    assert inner == [1]
    assert other.taken == []
    assert not outbox.deliveries()[0].perhaps_twice


def test_an_outbox_that_cannot_be_written_says_so(outbox):
    outbox.path.mkdir(parents=True)
    with pytest.raises(StorageError, match="outbox"):
        outbox.put(message(), ["mail"])


EVENTS = st.tuples(
    st.sampled_from(["put", "deliver"]), st.sampled_from(["a", "b"]), st.sampled_from(["ok", "down", "die"])
)


@settings(max_examples=25)
@given(st.lists(EVENTS, max_size=12))
def test_in_any_order_of_events_each_message_arrives_and_twice_only_where_it_says_so(
    tmp_path_factory, events
):
    outbox, arrived, known = Outbox(tmp_path_factory.mktemp("home")), [], set()

    def send(how):
        def hand_over(message, _channel):
            if how == "down":
                raise DeliveryFailed("down")
            arrived.append(message.key)
            if how == "die":
                raise KeyboardInterrupt

        return hand_over

    for what, key, how in [*events, ("deliver", "", "ok")]:
        if what == "put":
            outbox.put(message(key), ["mail"])
            known.add(key)
            continue
        with suppress(KeyboardInterrupt):
            outbox.deliver(send(how), NOW, all_waiting=True)
    assert set(arrived) == known
    doubled = {key for key in known if arrived.count(key) > 1}
    assert doubled <= {d.message.key for d in outbox.deliveries() if d.perhaps_twice}
    assert all(d.state == "sent" for d in outbox.deliveries())


# ---------------------------------------------------------------- the courier

BEGIN = datetime(2026, 3, 1, 20, tzinfo=UTC)


@pytest.fixture
def servers(monkeypatch):
    """What each address was sent; the address ``hangs`` never answers until it is let go."""
    taken, let_go = {}, threading.Event()

    def send(message, channel):
        if "hangs" in channel:
            let_go.wait(30)
        taken.setdefault("hangs" if "hangs" in channel else "works", []).append(message.key)

    monkeypatch.setattr("bench.batch.messages.send", send)
    yield taken
    let_go.set()


def courier_to(home, *servers, say=print):
    hooks = [WebhookConfig(url=f"http://{name}.example/") for name in servers]
    return Courier(MessagesConfig(webhooks=hooks), Outbox(home), VirtualClock(BEGIN), say)


def test_a_working_webhook_gets_its_messages_while_another_one_hangs(tmp_path, servers):
    lines = []
    courier = courier_to(tmp_path, "hangs", "works", say=lines.append)
    for key in ("first", "second"):
        courier.write("end", "s", "t", run="r", folder=Path("/r"), key=key, place=(7, "b" * 64))
        wait_until(lambda key=key: key in servers.get("works", []), 10)
    begun = time.monotonic()
    courier.close(0.2)
    assert time.monotonic() - begun < 2
    assert servers == {"works": ["first", "second"]}
    assert lines == ["Messages not delivered yet: 2. See `starbench messages`."]
    assert Outbox(tmp_path).deliveries()[0].message.text == f"t\nLedger: run 7 of this bench, line {'b' * 64}"


def test_colours_of_a_terminal_are_in_no_message(tmp_path, servers):
    courier = courier_to(tmp_path, "works")
    words = "failed: \x1b[1mTypingError\x1b[0m\x07:\n\tat 3 \u00b0C"
    courier.write("failure", words, words, run="r", folder=Path("/r"), key="k")
    courier.close(5.0)
    (delivery,) = Outbox(tmp_path).deliveries()
    assert delivery.message.subject == "failed: TypingError: at 3 \u00b0C"
    assert delivery.message.text == "failed: TypingError:\n\tat 3 \u00b0C"


def test_messages_of_another_station_that_wait_are_served_too(tmp_path, servers):
    silent = courier_to(tmp_path, "hangs")
    silent.write("end", "s", "t", run="r", folder=Path("/r"), key="before")
    silent.close(0.1)
    outbox = Outbox(tmp_path)
    outbox.put(outbox.deliveries()[0].message, ["works, of a third station"])
    courier = courier_to(tmp_path, "works")
    courier.write("end", "s", "t", run="r", folder=Path("/r"), key="after")
    courier.close(0.5)
    assert sorted(servers["works"]) == ["after", "before"]

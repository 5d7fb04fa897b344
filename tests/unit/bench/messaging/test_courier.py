"""The courier: a run waits for no server, and a channel that hangs delays no other channel."""

import threading
import time
from datetime import UTC, datetime
from pathlib import Path

import pytest

from bench.base.clock import VirtualClock
from bench.messaging.messages import Courier
from bench.messaging.outbox import Outbox
from bench.stations.station_fields import MessagesConfig, WebhookConfig

NOW = datetime(2026, 3, 1, 20, tzinfo=UTC)


@pytest.fixture
def servers(monkeypatch):
    """What each address was sent; the address ``hangs`` never answers until it is let go."""
    taken, let_go = {}, threading.Event()

    def send(message, channel):
        if "hangs" in channel:
            let_go.wait(30)
        taken.setdefault("hangs" if "hangs" in channel else "works", []).append(message.key)

    monkeypatch.setattr("bench.messaging.messages.send", send)
    yield taken
    let_go.set()


def test_a_working_webhook_gets_its_messages_while_another_one_hangs(tmp_path, servers):
    hooks = [WebhookConfig(url="http://hangs.example/"), WebhookConfig(url="http://works.example/")]
    said = []
    courier = Courier(MessagesConfig(webhooks=hooks), Outbox(tmp_path), VirtualClock(NOW), said.append)
    for key in ("first", "second"):
        courier.write("end", "s", "t", run="r", folder=Path("/r"), key=key, place=(7, "b" * 64))
        begun = time.monotonic()
        while key not in servers.get("works", []) and time.monotonic() - begun < 10:
            time.sleep(0.01)
        assert key in servers["works"]
    begun = time.monotonic()
    courier.close(0.2)
    assert time.monotonic() - begun < 2
    assert servers == {"works": ["first", "second"]}
    assert said == ["Messages not delivered yet: 2. See `starbench messages`."]
    assert Outbox(tmp_path).deliveries()[0].message.text == f"t\nLedger: run 7 of this bench, line {'b' * 64}"


def test_colours_of_a_terminal_are_in_no_message(tmp_path, servers):
    courier = Courier(
        MessagesConfig(webhooks=[WebhookConfig(url="http://works.example/")]),
        Outbox(tmp_path),
        VirtualClock(NOW),
        print,
    )
    words = "failed: \x1b[1mTypingError\x1b[0m\x07:\n\tat 3 \u00b0C"
    courier.write("failure", words, words, run="r", folder=Path("/r"), key="k")
    courier.close(5.0)
    (delivery,) = Outbox(tmp_path).deliveries()
    assert delivery.message.subject == "failed: TypingError: at 3 \u00b0C"
    assert delivery.message.text == "failed: TypingError:\n\tat 3 \u00b0C"


def test_messages_of_another_station_that_wait_are_served_too(tmp_path, servers):
    silent = Courier(
        MessagesConfig(webhooks=[WebhookConfig(url="http://hangs.example/")]),
        Outbox(tmp_path),
        VirtualClock(NOW),
        print,
    )
    silent.write("end", "s", "t", run="r", folder=Path("/r"), key="before")
    silent.close(0.1)
    outbox = Outbox(tmp_path)
    outbox.put(outbox.deliveries()[0].message, ["works, of a third station"])
    courier = Courier(
        MessagesConfig(webhooks=[WebhookConfig(url="http://works.example/")]),
        outbox,
        VirtualClock(NOW),
        print,
    )
    courier.write("end", "s", "t", run="r", folder=Path("/r"), key="after")
    courier.close(0.5)
    assert sorted(servers["works"]) == ["after", "before"]

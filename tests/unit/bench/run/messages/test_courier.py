"""The courier: no run waits for a server, and what was left is delivered with the next run."""

import threading
import time
from datetime import UTC, datetime
from pathlib import Path

import pytest
from waiting import wait_until

from bench.base.clock import VirtualClock
from bench.run.messages.courier import courier_of
from bench.run.messages.outbox import DeliveryFailed, Message, Outbox
from bench.stations.messages_section import AppriseConfig, MessagesConfig

BEGIN = datetime(2026, 3, 1, 20, tzinfo=UTC)


@pytest.fixture(autouse=True)
def outbox(tmp_path, monkeypatch):
    monkeypatch.setenv("STARBENCH_HOME", str(tmp_path))
    return Outbox(tmp_path)


@pytest.fixture
def servers(monkeypatch):
    """What each address was sent; the address ``HANGS`` does not answer until it is let go."""
    taken, let_go = {}, threading.Event()

    def send(message, channel):
        if channel.url_env == "HANGS":
            let_go.wait(30)
            raise DeliveryFailed("timed out")
        taken.setdefault(channel.url_env, []).append(message.key)

    monkeypatch.setattr("bench.run.messages.courier.send", send)
    yield taken, let_go
    let_go.set()


def station_with(*servers):
    return MessagesConfig(apprise=[AppriseConfig(url_env=name) for name in servers])


def write(courier, station, key, subject="s", text="t", **words):
    courier.write(station, "end", subject, text, run="r", folder=Path("/r"), key=key, **words)


def test_a_server_that_hangs_delays_no_run_and_the_next_run_delivers(outbox, servers):
    (taken, let_go), lines, station = servers, [], station_with("HANGS", "WORKS")
    courier = courier_of(station, VirtualClock(BEGIN), lines.append)
    begun = time.monotonic()
    for key in ("first", "second"):
        write(courier, station, key, place=(7, "b" * 64))
    courier.close(0.2)
    assert time.monotonic() - begun < 2
    (line,) = lines
    assert f": {outbox.unsent()}. " in line
    let_go.set()
    wait_until(lambda: sorted(taken.get("WORKS", [])) == ["first", "second"], 10)
    courier_of(station, VirtualClock(BEGIN), lines.append).close(5.0)
    assert sorted(taken["WORKS"]) == ["first", "second"]
    assert outbox.deliveries()[0][1].message.text == f"t\nLedger: run 7 of this bench, line {'b' * 64}"


def test_what_a_terminal_colours_and_what_no_text_can_hold_is_in_no_message(outbox, servers):
    station = station_with("WORKS")
    courier = courier_of(station, VirtualClock(BEGIN), print)
    words = "failed: \x1b[1mTypingError\x1b[0m\x07:\n\tat 3 \u00b0C\udcff"
    write(courier, station, "k", words, words)
    courier.close(5.0)
    ((state, delivery),) = outbox.deliveries()
    assert state == "sent"
    assert delivery.message.subject == "failed: TypingError: at 3 \u00b0C?"
    assert delivery.message.text == "failed: TypingError:\n\tat 3 \u00b0C?"


def test_what_fails_is_tried_again_ever_more_seldom_and_a_new_message_at_once(outbox, monkeypatch):
    tries, station = [], station_with("WORKS")

    def send(message, _channel):
        tries.append((message.key, time.monotonic()))
        raise DeliveryFailed("down")

    monkeypatch.setattr("bench.run.messages.courier.send", send)
    monkeypatch.setattr("bench.run.messages.courier.FIRST_PAUSE_S", 0.1)
    courier = courier_of(station, VirtualClock(BEGIN), [].append)
    write(courier, station, "old")
    wait_until(lambda: len(tries) == 4, 10)
    (_, first), (_, second), (_, third), (_, fourth) = tries
    assert fourth - third > third - second > second - first
    write(courier, station, "new")
    courier.close(5.0)
    assert [key for key, _ in tries][4] == "new"


def test_messages_of_another_station_that_wait_are_delivered_too(outbox, servers):
    message = Message("before", "end", "s", "t", "r", "/r", BEGIN.isoformat())
    outbox.put(message, station_with("WORKS").channels)
    courier_of(station_with("HANGS"), VirtualClock(BEGIN), print).close(5.0)
    assert servers[0] == {"WORKS": ["before"]}


def test_a_station_that_wants_no_message_gets_none(outbox):
    assert courier_of(MessagesConfig(), VirtualClock(BEGIN), print) is None
    wants = MessagesConfig(occasions=["failure"], apprise=[AppriseConfig(url_env="WORKS")])
    courier = courier_of(wants, VirtualClock(BEGIN), print)
    write(courier, wants, "k")
    courier.close(5.0)
    assert outbox.deliveries() == []

"""The client of the simulated EVK4 against answers that are late, wrong, or none."""

import json
import socket
import threading
import time
from contextlib import suppress

import pytest
from camera_words import words_of
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.camera.simulated_evk4 import SimulatedEvk4Camera
from drivers.clock import SystemClock
from drivers.errors import DeviceRefused, DriverError, ReplyGarbled, ReplyTimeout
from tests.hil.evk4_client.clocks import HurryingClock, SteppedClock
from tests.hil.evk4_client.peer import NOW, WHO, frame


def test_an_answer_that_is_long_in_computing_is_waited_for(peer, connect):
    clock = SteppedClock()
    camera = connect(clock=clock)
    peer.do_monitor = lambda number, _: (
        clock.let_pass(500, peer),
        peer.answer(number, temperature_c=41.5),
    )
    assert camera.temperature_c() == 41.5
    assert clock.now == 500


def test_a_camera_that_does_not_answer_is_given_up_after_its_time(peer, connect):
    peer.deaf_to.add("monitor")
    clock = HurryingClock()
    camera = connect(clock=clock)
    clock.hurry = True
    with pytest.raises(ReplyTimeout, match=r'"monitor"; .* 3[0-9.]+ s'):
        camera.temperature_c()


def test_a_late_answer_is_not_taken_for_the_next_one(peer, connect):
    peer.deaf_to.add("monitor")
    clock = HurryingClock()
    camera = connect(clock=clock)
    clock.hurry = True
    with pytest.raises(ReplyTimeout):
        camera.temperature_c()
    clock.hurry = False
    peer.do_get_filters = lambda number, _: (
        peer.answer(number - 1, temperature_c=41.5),
        peer.answer(number, afk=False),
    )
    assert camera.filters() == {"afk": False}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"serial": 50423}, '"serial"'),
        ({"width": "1280"}, '"width"'),
        ({"height": None}, '"height"'),
        ({"format": "EVT2"}, "EVT2, not EVT3"),
    ],
)
def test_an_answer_of_another_shape_is_refused(peer, connect, change, message):
    peer.identity.update(change)
    with pytest.raises(ReplyGarbled, match=message):
        connect()


@pytest.mark.parametrize(
    ("kind", "payload"),
    [(b"X", b""), (b"A", b"{"), (b"A", b"[]"), (b"D", b"\x00"), (b"A", b"[" * 100_000)],
)
def test_bytes_that_are_no_frame_are_refused(peer, connect, kind, payload):
    camera = connect()
    peer.do_monitor = lambda *_: peer.send(kind, payload)
    with pytest.raises(ReplyGarbled):
        camera.temperature_c()


ANSWERS = st.sampled_from(
    [
        frame(b"A", json.dumps({"id": 1, "ok": True, **WHO}).encode()),
        frame(b"A", b'{"id": 1, "ok": true}'),
        frame(b"A", b'{"id": 1, "ok": false, "error": 5}'),
        frame(b"A", b'{"id": 1, "ok": true, "maker": [], "format": "EVT3"}'),
        frame(b"N", b'{"event": "fault"}'),
        frame(b"N", b"[]"),
        frame(b"D", words_of(0)),
    ]
)


@settings(max_examples=150)
@given(st.lists(ANSWERS | st.binary(max_size=60), max_size=5), st.integers(1, 40))
def test_whatever_a_peer_sends_ends_in_an_identity_or_a_drivers_error(pieces, cut):
    sent = b"".join(pieces)
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def serve():
            link, _ = listener.accept()
            with link, suppress(OSError):  # the client may have hung up on it
                for k in range(0, len(sent), cut):
                    link.sendall(sent[k : k + cut])

        peer = threading.Thread(target=serve)
        peer.start()
        try:
            SimulatedEvk4Camera.open(
                f"127.0.0.1:{listener.getsockname()[1]}",
                clock=SystemClock(),
                utc_now=lambda: NOW,
                silence_s=5.0,
            ).close()
            ended = "an identity"
        except DriverError as error:  # anything else it raises fails the test
            ended = str(error)
        peer.join()
    assert ended


def test_a_refusal_says_what_was_asked(peer, connect):
    peer.do_monitor = lambda number, _: peer.refuse(number, "broken", "The sensor is off.")
    with pytest.raises(DeviceRefused, match=r'"monitor": The sensor'):
        connect().temperature_c()


def test_a_camera_that_never_answers_is_given_up_within_seconds():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        address = f"127.0.0.1:{listener.getsockname()[1]}"
        began = time.monotonic()
        with pytest.raises(ReplyTimeout):
            SimulatedEvk4Camera.open(address, clock=SystemClock(), utc_now=lambda: NOW)
    assert time.monotonic() - began < 40.0  # a busy computer stretches it by 30 s at most

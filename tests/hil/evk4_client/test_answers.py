"""The client of the simulated EVK4 against answers that are late, wrong, or none."""

import json
import socket
import threading
from contextlib import suppress

import pytest
from camera_words import words_of
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.camera.simulated_evk4 import SimulatedEvk4Camera
from drivers.clock import SystemClock
from drivers.errors import DriverError, ReplyGarbled, ReplyTimeout
from tests.hil.evk4_client.clocks import HurryingClock
from tests.hil.evk4_client.peer import NOW, WHO, frame


def test_a_late_answer_is_not_taken_for_the_next_one(peer, connect):
    peer.deaf_to.add("monitor")
    clock = HurryingClock()
    camera = connect(clock=clock)
    clock.hurry = True
    with pytest.raises(ReplyTimeout):
        camera.temperature_c()
    clock.hurry = False
    peer.before_answer["get_filters"] = lambda request: peer.answer(request["id"] - 1, temperature_c=41.5)
    assert camera.filters() == peer.filters


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
    peer.answers["identify"].update(change)
    with pytest.raises(ReplyGarbled, match=message):
        connect()


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
            address = f"127.0.0.1:{listener.getsockname()[1]}"
            SimulatedEvk4Camera.open(address, clock=SystemClock(), utc_now=lambda: NOW, silence_s=5.0).close()
            ended = "an identity"
        except DriverError as error:  # anything else it raises fails the test
            ended = str(error)
        peer.join()
    assert ended

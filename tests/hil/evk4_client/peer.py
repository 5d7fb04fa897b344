"""A scripted camera on a socket, which answers as the protocol says, but for what a test changes."""

import json
import socket
import struct
import threading
from datetime import UTC, datetime

from camera_words import words_of

from tests.hil.evk4_host import exactly

WHO = {
    "maker": "Prophesee",
    "model": "EVK4 (simulated)",
    "sensor": "IMX636",
    "serial": "00050423",
    "firmware": "1.0",
    "width": 1280,
    "height": 720,
    "format": "EVT3",
}


NOW = datetime(2026, 11, 20, 4, 5, 6, tzinfo=UTC)


class Peer:
    """A camera that answers as the protocol says, but for what a test changes."""

    def __init__(self):
        self.identity = dict(WHO)
        self.biases = {"bias_diff_on": 0, "bias_diff_off": 0, "bias_fo": 0, "bias_hpf": 0, "bias_refr": 0}
        self.filters = {"afk": True, "stc": False, "trail": False, "erc": True}
        self.trigger_in = False
        self.deaf_to = set()
        self.before_frame = {}
        self.frames = 10**9
        self.asked = []
        self.kept = None
        self.closed = threading.Event()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self):
        self._listener.close()
        self._thread.join(10)

    def send(self, kind, payload):
        self.link.sendall(kind + struct.pack("<I", len(payload)) + payload)

    def answer(self, number, **values):
        self.send(b"A", json.dumps({"id": number, "ok": True, **values}).encode())

    def refuse(self, number, code, message):
        self.send(b"A", json.dumps({"id": number, "ok": False, "error": code, "message": message}).encode())

    def _serve(self):
        try:
            self.link, _ = self._listener.accept()
            with self.link:
                while True:
                    self._handle(self._request())
        except OSError:
            self.closed.set()

    def _request(self):
        head = exactly(self.link, 5)
        assert head[:1] == b"Q"
        request = json.loads(exactly(self.link, struct.unpack("<I", head[1:])[0]))
        self.asked.append(request["cmd"])
        self.kept = request.get("frames")
        return request

    def _handle(self, request):
        if request["cmd"] not in self.deaf_to:
            getattr(self, "do_" + request["cmd"])(request["id"], request)

    def do_identify(self, number, _):
        self.answer(number, **self.identity)

    def do_get_biases(self, number, _):
        self.answer(number, biases=self.biases)

    def do_set_bias(self, number, request):
        self.biases[request["name"]] = request["value"]
        self.answer(number)

    def do_get_filters(self, number, _):
        self.answer(number, **self.filters)

    def do_set_filter(self, number, request):
        self.filters[request["name"]] = request["enabled"]
        self.answer(number)

    def do_get_trigger_in(self, number, _):
        self.answer(number, enabled=self.trigger_in)

    def do_set_trigger_in(self, number, request):
        self.trigger_in = request["enabled"]
        self.answer(number)

    def do_monitor(self, number, _):
        self.answer(number, temperature_c=41.5, illumination_lux=120.0, pixel_dead_time_us=6.0)

    def do_stop(self, number, _):
        self.answer(number)

    def do_start(self, number, _):
        self.answer(number)
        self.link.setblocking(False)
        for step in range(self.frames):
            self.before_frame.get(step, lambda: None)()
            self.link.setblocking(True)
            self.send(b"D", words_of(step))
            self.link.setblocking(False)
            try:
                if self.link.recv(1, socket.MSG_PEEK) is not None:
                    break
            except BlockingIOError:
                continue
        self.link.setblocking(True)
        self._stop_with_a_last_frame()

    def _stop_with_a_last_frame(self):
        request = self._request()
        if request["cmd"] not in self.deaf_to:
            self.send(b"D", words_of(10**6))
            self.answer(request["id"])


def frame(kind, payload):
    return kind + struct.pack("<I", len(payload)) + payload

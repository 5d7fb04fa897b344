"""A scripted camera on a socket, which answers as the protocol says, but for what a test changes."""

import json
import select
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
        self.filters = {"afk": True, "stc": False, "trail": False, "erc": True}
        self.biases = {"bias_diff_on": 0, "bias_diff_off": 0, "bias_fo": 0, "bias_hpf": 0, "bias_refr": 0}
        self.trigger_in = {"enabled": False}
        self.answers = {
            "identify": dict(WHO),
            "get_biases": {"biases": self.biases},
            "get_filters": self.filters,
            "get_trigger_in": self.trigger_in,
            "monitor": {"temperature_c": 41.5, "illumination_lux": 120.0, "pixel_dead_time_us": 6.0},
        }
        self.before_answer = {}
        self.deaf_to = set()
        self.before_frame = {}
        self.frames = 10**9
        self.asked = []
        self.closed = threading.Event()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self):
        self._listener.close()
        self._thread.join(10)

    def send(self, kind, payload):
        self.link.sendall(frame(kind, payload))

    def answer(self, number, **values):
        self.send(b"A", json.dumps({"id": number, "ok": True, **values}).encode())

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
        return request

    def _handle(self, request):
        command, number = request["cmd"], request["id"]
        if command in self.deaf_to:
            return
        self.before_answer.get(command, self._set)(request)
        self.answer(number, **self.answers.get(command, {}))
        if command == "start":
            self._stream()

    def _set(self, request):
        match request["cmd"]:
            case "set_bias":
                self.biases[request["name"]] = request["value"]
            case "set_filter":
                self.filters[request["name"]] = request["enabled"]
            case "set_trigger_in":
                self.trigger_in["enabled"] = request["enabled"]

    def _stream(self):
        """Send words until a request comes. Send some more before the answer, as a camera does."""
        for step in range(self.frames):
            self.before_frame.get(step, lambda: None)()
            self.send(b"D", words_of(step))
            if select.select([self.link], [], [], 0.0)[0]:
                break
        request = self._request()
        if request["cmd"] not in self.deaf_to:
            self.send(b"D", words_of(10**6))
            self.answer(request["id"])


def frame(kind, payload):
    return kind + struct.pack("<I", len(payload)) + payload

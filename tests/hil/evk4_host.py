"""A host of the simulated EVK4, as small as can be, and a small camera for it; not a test."""

import json
import socket
import struct

from simulators.world.truth_config import truth_from_config
from simulators.world.world import LightState, World

SMALL = truth_from_config(
    {"camera": {"fx": 800, "fy": 800, "cx": 160, "cy": 90, "width": 320, "height": 180}}
)
FLICKER = LightState(output=True, sync=True)
COMPUTING = b'{"event": "computing"}'


def exactly(link, n):
    """So many bytes from a socket."""
    data = b""
    while len(data) < n:
        part = link.recv(n - len(data))
        if not part:
            raise ConnectionResetError
        data += part
    return data


class Host:
    """A host as small as can be."""

    def __init__(self, camera):
        host, port = camera.address.split(":")
        self.link = socket.create_connection((host, int(port)), timeout=60)
        self.words = []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.link.close()

    def frame(self):
        """The next frame that is not only a sign that it computes."""
        while (frame := self.any_frame()) == (b"N", COMPUTING):
            pass
        return frame

    def any_frame(self):
        kind, length = struct.unpack("<cI", exactly(self.link, 5))
        return kind, exactly(self.link, length)

    def ask(self, cmd, **more):
        self.send(b"Q", json.dumps({"id": 7, "cmd": cmd, **more}).encode())
        while True:
            kind, payload = self.frame()
            if kind == b"D":
                self.words.append(payload)
            else:
                assert kind == b"A"
                return json.loads(payload)

    def send(self, kind, payload):
        self.link.sendall(struct.pack("<cI", kind, len(payload)) + payload)

    def drain(self):
        """Take frames until the connection ends."""
        while True:
            self.frame()

    def record(self, frames):
        """Words of that many frames, with the trigger input enabled."""
        assert self.ask("set_trigger_in", enabled=True)["ok"]
        self.words = []
        assert self.ask("start")["ok"]
        while len(self.words) < frames:
            kind, payload = self.frame()
            assert kind == b"D"
            self.words.append(payload)
        assert self.ask("stop", frames=frames)["ok"]
        return b"".join(self.words[:frames])


def bench(**world):
    world = World(SMALL, **world)
    world.set_light(FLICKER)
    return world

"""A model of two chained Zaber controllers, in memory, on a clock that only the driver's own waits turn."""

from __future__ import annotations

import math
import re

from drivers.stage import AxisLimits
from drivers.stage.zaber import ZaberAxis
from tests.unit.drivers.peer_port import PeerPort

SCALE = 1000


def close_line(body: str) -> bytes:
    return f"@{body}:{-sum(body.encode()) & 0xFF:02X}\r\n".encode()


class Controller:
    """One axis that moves evenly at its speed; `encoder` None means that it has none."""

    def __init__(self, serial: str, clock) -> None:
        self.clock = clock
        self.flags = ["WR"]
        self.encoder: int | None = None
        self.parked = False
        self.settings = {
            "system.serial": serial,
            "deviceid": "50958",
            "version": "7.38",
            "limit.min": "-15000",
            "limit.max": "15000",
            "maxspeed": "1",
            "accel": "1",
        }
        self.start = self.goal = 2400.0
        self.began_s = -math.inf
        self.speed = 10_000.0

    def position(self) -> int:
        run = (self.clock.now_s - self.began_s) * self.speed
        way = self.goal - self.start
        return round(self.goal if run >= abs(way) else self.start + math.copysign(run, way))

    def busy(self) -> bool:
        return self.position() != round(self.goal)

    def go(self, goal: float) -> None:
        self.start, self.goal, self.began_s = float(self.position()), float(goal), self.clock.now_s

    def refusal(self) -> str:
        return "PARKED" if self.parked else "BADCOMMAND"

    def restart(self) -> None:
        self.start = self.goal = 0.0
        self.flags = ["WR"]

    def stop(self) -> None:
        if self.busy():
            self.flags.append("NI")
        self.start = self.goal = float(self.position())

    def answer(self, words: list[str]) -> str | None:
        """Data of the reply; None to reject the command."""
        match words:
            case ["tools", "parking", way]:
                self.parked = way == "park"
                return "0"
            case ["move" | "home", *_] if self.parked:
                return None
            case ["get", "pos"]:
                return str(self.position())
            case ["get", "encoder.pos"]:
                return None if self.encoder is None else str(self.position() + self.encoder)
            case ["get", name]:
                return self.settings.get(name)
            case ["set", name, value] if name in self.settings:
                self.settings[name] = value
                return "0"
            case ["home"]:
                self.go(0.0)
                self.flags = []
                return "0"
            case ["move", "abs", goal] if re.fullmatch(r"-?\d+", goal):
                self.go(float(goal))
                return "0"
            case ["stop"]:
                self.stop()
                return "0"
            case ["warnings", *clear]:
                told = " ".join([f"{len(self.flags):02d}", *self.flags])
                if clear:
                    self.flags = [flag for flag in self.flags if flag == "WR"]
                return told
            case []:
                return "0"
        return None


class ZaberPeer(PeerPort):
    """Two chained controllers behind a port. `spoil` may change a reply line, `before` sees each request."""

    name = "gimbal"

    def __init__(self, clock) -> None:
        super().__init__()
        self.pan, self.tilt = Controller("100101", clock), Controller("100102", clock)

    def write(self, data: bytes) -> None:
        self.sent.append(data)
        request = re.fullmatch(rb"/(\d \d \d\d(?: [ -9;-~]+)?):([0-9A-F]{2})\n", data)
        if request is None or (sum(request[1]) + int(request[2], 16)) % 256:
            return  # as the real ones: a request that breaks form or checksum is not answered
        body = request[1].decode()
        self.before(body)
        address, axis, message_id, *words = body.split(" ")
        for number, controller in ((1, self.pan), (2, self.tilt)):
            if int(address) in {0, number}:
                data_back = controller.answer(words)
                verdict = "RJ" if data_back is None else "OK"
                state = "BUSY" if controller.busy() else "IDLE"
                flag = controller.flags[0] if controller.flags else "--"
                text = f"{number:02d} {axis} {message_id} {verdict} {state} {flag} {data_back or controller.refusal()}"
                self.ready += self.spoil(close_line(text))

    def motions(self) -> list[bytes]:
        return [line for line in self.sent if b"move" in line or b"home" in line]


def axes(**changes) -> list[ZaberAxis]:
    limits = AxisLimits(-15.0, 15.0, 10.0, 50.0)
    return [
        ZaberAxis(name="pan", device=1, serial="100101", microsteps_per_deg=SCALE, limits=limits, **changes),
        ZaberAxis(name="tilt", device=2, serial="100102", microsteps_per_deg=SCALE, limits=limits, **changes),
    ]

"""A model of an XIMC controller in memory, on a clock that only the driver's own waits turn."""

from __future__ import annotations

import math
import struct

from tests.unit.drivers.peer_port import PeerPort

WITH_DATA = {"move": 12, "smov": 24, "seds": 20}
BARE = {
    "geti",
    "gser",
    "gfwv",
    "gets",
    "gmov",
    "geds",
    "geng",
    "gent",
    "gfbs",
    "home",
    "stop",
    "sstp",
    "zero",
}
DIVISION = 256


def crc(data: bytes) -> bytes:
    """Compute the CRC bit by bit over a polynomial of 17 bits, another way than the driver's."""
    register = 0xFFFF
    for byte in data:
        for place in range(8):
            top = (register ^ (byte >> place)) & 1
            register = (register >> 1) ^ (0xA001 * top)
    return struct.pack("<H", register)


class XimcPeer(PeerPort):
    """One axis. `spoil` may change a reply, `before` sees each command."""

    def __init__(self, clock, serial: int = 12345, name: str = "ximc") -> None:
        super().__init__()
        self.name = name
        self.clock = clock
        self.serial = serial
        self.engine_type = 3
        self.feedback = 5
        self.flags = 0
        self.command_state = 0
        self.start = self.goal = 700.0 * DIVISION
        self.began_s = -math.inf
        self.speed = 800.0 * DIVISION
        self.slip = 0
        self.mov = struct.pack("<IBHHIBB9s", 1000, 0, 2000, 2000, 50, 0, 0, b"reserved!")
        self.eds = struct.pack("<BBihih6s", 0x07, 0, -2000, 0, 2000, 0, b"\0" * 6)
        self.pending = b""

    def position(self) -> int:
        run = (self.clock.now_s - self.began_s) * self.speed
        way = self.goal - self.start
        return round(self.goal if run >= abs(way) else self.start + math.copysign(run, way))

    def busy(self) -> bool:
        return self.position() != round(self.goal)

    def go(self, goal: float, command: int) -> None:
        self.start, self.goal, self.began_s = float(self.position()), float(goal), self.clock.now_s
        self.command_state = command

    def halt(self) -> None:
        self.start = self.goal = float(self.position())

    def write(self, data: bytes) -> None:
        self.sent.append(data)
        self.pending += data
        while self.pending:
            if self.pending[0] == 0:
                self.pending = self.pending[1:]
                self.ready += b"\0"
                continue
            if len(self.pending) < 4:
                return
            command = self.pending[:4].decode("latin-1")
            size = 4 + (WITH_DATA[command] + 2 if command in WITH_DATA else 0)
            if len(self.pending) < size:
                return
            whole, self.pending = self.pending[:size], self.pending[size:]
            self.ready += self.spoil(self.serve(command, whole[4:-2], whole[-2:]))

    def serve(self, command: str, data: bytes, given: bytes) -> bytes:
        if command in WITH_DATA and crc(data) != given:
            return b"errd"
        if command not in WITH_DATA and command not in BARE:
            return b"errc"
        self.before(command)
        answer = self.answer(command, data)
        return command.encode() + (answer + crc(answer) if answer else b"")

    def answer(self, command: str, data: bytes) -> bytes:
        match command:
            case "gser":
                return struct.pack("<I", self.serial)
            case "geti":
                return struct.pack("<4s2s8sBBH12x", b"XIMC", b"SM", b"8SMC5\0\0\0", 2, 3, 7)
            case "gfwv":
                return struct.pack("<BBH", 4, 7, 1)
            case "gent":
                return struct.pack("<BB6x", self.engine_type, 2)
            case "gfbs":
                return struct.pack("<HBBI4x", 0, self.feedback, 0, 4000)
            case "geng":
                return struct.pack("<HHIBHhBH12x", 0, 0, 5000, 0, 0, 0, 9, 200)
            case "gmov":
                return self.mov
            case "geds":
                return self.eds
            case "gets":
                return self.status()
            case "smov":
                self.mov = data
            case "seds":
                self.eds = data
            case "move":
                steps, micro = struct.unpack("<ih6x", data)
                self.go(steps * DIVISION + micro, 1)
            case "home":
                self.go(-100.0, 6)
                self.flags |= 0x20
            case "zero":
                self.start = self.goal = 0.0
            case "stop" | "sstp":
                self.halt()
                self.command_state = 5 if command == "stop" else 8
        return b""

    def status(self) -> bytes:
        state = self.command_state | (0x80 if self.busy() else 0)
        position = self.position()
        steps, micro = divmod(abs(position), DIVISION)
        sign = 1 if position >= 0 else -1
        return struct.pack(
            "<5Bihqih5hIIB4x",
            0, state, 3, 4, 0x33, sign * steps, sign * micro, position // 64 + self.slip,
            0, 0, 0, 0, 0, 0, 0, self.flags, 0, 1,
        )  # fmt: skip

    def motions(self) -> list[bytes]:
        return [data for data in self.sent if data[:4] in {b"move", b"movr", b"home", b"left", b"rigt"}]

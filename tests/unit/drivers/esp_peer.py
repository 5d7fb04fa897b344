"""A model of a Newport ESP controller in memory, on a clock that only the driver's own waits turn."""

from __future__ import annotations

import math
import re

from tests.unit.drivers.peer_port import PeerPort


class EspAxisModel:
    def __init__(self, clock, serial: str) -> None:
        self.clock = clock
        self.values = {"SN": 7.0, "SL": -20.0, "SR": 20.0, "VA": 1.0, "AC": 4.0, "AG": 4.0}
        self.identity = f"URS75CC, {serial}"
        self.motor = False
        self.start = self.goal = 3.0
        self.began_s = -math.inf
        self.speed = 10.0
        self.stuck = False

    def position(self) -> float:
        run = (self.clock.now_s - self.began_s) * self.speed
        way = self.goal - self.start
        return round(self.goal if run >= abs(way) else self.start + math.copysign(run, way), 4)

    def busy(self) -> bool:
        return self.stuck or self.position() != round(self.goal, 4)

    def go(self, goal: float) -> None:
        self.start, self.goal, self.began_s = self.position(), goal, self.clock.now_s

    def halt(self) -> None:
        self.start = self.goal = self.position()


class EspPeer(PeerPort):
    """Two axes. `spoil` may change a line it says, `before` sees each command."""

    name = "esp"

    def __init__(self, clock) -> None:
        super().__init__()
        self.clock = clock
        self.axes = {1: EspAxisModel(clock, "SN1263"), 2: EspAxisModel(clock, "SN1264")}
        self.errors: list[tuple[int, str]] = []
        self.cycles = 450_000
        self.homes = True
        self.pending = b""

    def write(self, data: bytes) -> None:
        *commands, self.pending = (self.pending + data).split(b"\r")
        for command in commands:
            text = command.decode("latin-1")
            self.sent.append(text)
            self.before(text)
            answer = self.serve(text)
            if answer is not None:
                self.ready += self.spoil(f"{answer}\r\n".encode())

    def serve(self, text: str) -> str | None:
        self.cycles += 25
        if text == "VE?":
            return "ESP301 Version 3.0.1 6/1/99"
        if text == "TB?":
            code, words = self.errors.pop(0) if self.errors else (0, "NO ERROR DETECTED")
            return f"{code}, {self.cycles}, {words}"
        if text == "ST":
            for axis in self.axes.values():
                axis.halt()
            return None
        match = re.fullmatch(r"([12])([A-Z]{2})(\?|-?\d+(?:\.\d+)?)?", text)
        if match is None:
            self.errors.append((6, "COMMAND DOES NOT EXIST"))
            return None
        return self.axis(int(match[1]), match[2], match[3])

    def axis(self, number: int, word: str, value: str | None) -> str | None:
        axis = self.axes[number]
        match word, value:
            case "ID", "?":
                return axis.identity
            case "MD", "?":
                return "0" if axis.busy() else "1"
            case "MO", "?":
                return "1" if axis.motor else "0"
            case "TP", None:
                return f"{axis.position():.4f}"
            case "MO", None:
                axis.motor = True
            case "ST", None:
                axis.halt()
            case "OR", "1":
                axis.go(0.0)
                if not self.homes:
                    self.errors.append((100 * number + 20, "HOMING ABORTED"))
            case "PA", str():
                self.move(number, float(value))
            case _, "?" if word in axis.values:
                return f"{axis.values[word]:.5f}".rstrip("0").rstrip(".")
            case _, str() if word in axis.values:
                axis.values[word] = float(value)
            case _:
                self.errors.append((6, "COMMAND DOES NOT EXIST"))
        return None

    def move(self, number: int, goal: float) -> None:
        axis = self.axes[number]
        if not axis.motor:
            self.errors.append((100 * number + 13, "MOTOR NOT ENABLED"))
        elif not axis.values["SL"] <= goal <= axis.values["SR"]:
            self.errors.append((100 * number + 6, "POSITIVE SOFTWARE LIMIT"))
        else:
            axis.go(goal)

    def restart(self) -> None:
        self.cycles = 0
        for axis in self.axes.values():
            axis.motor = False
            axis.start = axis.goal = 0.0

    def motions(self) -> list[str]:
        return [text for text in self.sent if re.match(r"\d(PA|PR|OR|MV)[^?]*$", text)]

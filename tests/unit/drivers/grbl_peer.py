"""A model of a GRBL 1.1 board in memory, on a clock that only the driver's own waits turn."""

from __future__ import annotations

import math
import re

from tests.unit.drivers.peer_port import PeerPort

SETTINGS = {
    10: 1,
    20: 0,
    22: 1,
    100: 100.0,
    101: 100.0,
    110: 500.0,
    111: 500.0,
    120: 10.0,
    121: 10.0,
    130: 40.0,
    131: 40.0,
}


class GrblPeer(PeerPort):
    """Two axes. `spoil` may change a line it says, `before` sees each line or real-time byte."""

    name = "grbl"

    def __init__(self, clock) -> None:
        super().__init__()
        self.clock = clock
        self.settings = dict(SETTINGS)
        self.build = "1.1h.20190830:gimbal-7"
        self.state = "Alarm"
        self.start = self.goal = (0.0, 0.0)
        self.began_s = -math.inf
        self.feed = 1.0
        self.homing_s = 2.0
        self.homed_at_s = math.inf
        self.homes = True
        self.pending = b""
        self.lost_resets = 0  # for 0.5 s after an alarm the firmware forgets a reset
        self.mute = False  # after a limit the firmware waits in a loop that serves a reset only

    # ------------------------------------------------------------ physics
    def share(self) -> float:
        """Share of the way that is done."""
        way = math.dist(self.start, self.goal)
        done = (self.clock.now_s - self.began_s) * self.feed / 60.0
        return 1.0 if done >= way else done / way

    def machine(self) -> tuple[float, ...]:
        share = self.share()
        return tuple(round(a + share * (b - a), 2) for a, b in zip(self.start, self.goal, strict=True))

    def now(self) -> str:
        return "Jog" if self.state == "Idle" and self.share() < 1.0 else self.state

    def go(self, goal: tuple[float, ...], feed: float) -> None:
        self.start, self.goal, self.feed, self.began_s = self.machine(), goal, feed, self.clock.now_s

    def halt(self) -> None:
        self.start = self.goal = self.machine()

    def restart(self) -> None:
        self.start = self.goal = (0.0, 0.0)
        self.homed_at_s = math.inf
        self.state = "Alarm"
        self.say("")
        self.say("Grbl 1.1h ['$' for help]")
        self.say("[MSG:'$H'|'$X' to unlock]")

    def alarm(self, code: int) -> None:
        self.halt()
        self.state = "Alarm"
        self.say(f"ALARM:{code}")
        if code in (1, 2):
            self.say("[MSG:Reset to continue]")
            self.mute = True

    # ------------------------------------------------------------ words
    def say(self, text: str) -> None:
        self.ready += self.spoil(f"{text}\r\n".encode())

    def write(self, data: bytes) -> None:
        self.sent.append(data)
        for place in range(len(data)):
            byte = data[place : place + 1]
            if byte in b"?!\x85\x18":
                self.before(byte.decode("latin-1"))
                self.realtime(byte)
            elif byte == b"\n":
                line, self.pending = self.pending.decode("latin-1"), b""
                self.before(line)
                if self.homed_at_s == math.inf and not self.mute:
                    self.serve(line)
            else:
                self.pending += byte

    def realtime(self, byte: bytes) -> None:
        if self.mute and byte != b"\x18":
            return
        if self.mute and self.lost_resets:
            self.lost_resets -= 1
            return
        self.mute = False
        if byte == b"?" and self.homed_at_s == math.inf:
            self.say(f"<{self.now()}|MPos:{','.join(f'{x:.3f}' for x in self.machine())}|FS:0,0>")
        elif byte == b"\x85":
            self.halt()
        elif byte == b"\x18":
            self.pending = b""
            if self.share() < 1.0 or self.homed_at_s != math.inf:
                self.say("ALARM:3")
            self.restart()

    def serve(self, line: str) -> None:
        jog = re.fullmatch(r"\$J=G21G53((?:[XY]-?\d+\.\d+)+)F(\d+\.\d+)", line)
        if line == "":
            self.say("ok")
        elif line == "$I":
            self.say(f"[VER:{self.build}]")
            self.say("[OPT:V,15,128]")
            self.say("ok")
        elif line == "$$":
            for number, value in self.settings.items():
                self.say(f"${number}={value:.3f}" if number >= 100 else f"${number}={value:.0f}")
            self.say("ok")
        elif match := re.fullmatch(r"\$(\d+)=(\d+(?:\.\d+)?)", line):
            self.settings[int(match[1])] = float(match[2])
            self.say("ok")
        elif line == "$H":
            self.homed_at_s = self.clock.now_s + self.homing_s
        elif jog:
            self.jog(jog)
        else:
            self.say("error:20")

    def jog(self, jog: re.Match[str]) -> None:
        goal = list(self.machine())
        for letter, number in re.findall(r"([XY])(-?\d+\.\d+)", jog[1]):
            goal["XY".index(letter)] = float(number)
        if self.now() not in {"Idle", "Jog"}:
            self.say("error:9")
        elif any(not -self.settings[130 + n] <= x <= 0 for n, x in enumerate(goal)):
            self.say("error:15")
        else:
            self.go(tuple(goal), float(jog[2]))
            self.say("ok")

    def read(self, timeout_s: float) -> bytes:
        if self.clock.now_s >= self.homed_at_s:
            self.homed_at_s = math.inf
            self.start = self.goal = (-1.0, -1.0)
            if self.homes:
                self.state = "Idle"
                self.say("ok")
            else:
                self.alarm(9)
                self.say("error:5")
        data, self.ready = self.ready, b""
        return data

    def motions(self) -> list[bytes]:
        return [data for data in self.sent if data.startswith((b"$J", b"$H", b"G"))]

"""A simulated turntable, written from its protocol and not from the driver."""

from __future__ import annotations

from collections.abc import Callable, Mapping

SPEED_DEG_S = 30.0


class SimulatedTurntable:
    """Answers bytes, and tells where it really is."""

    baud = 115_200

    def __init__(self, clock: Callable[[], float], serial: str = "T7") -> None:
        self._clock = clock
        self._serial = serial
        self._buffer = b""
        self._referenced = False
        self._begin_deg, self._goal_deg, self._began_s = 3.0, 3.0, 0.0

    def angles_deg(self) -> Mapping[str, float]:
        """Where the axis is."""
        way = self._goal_deg - self._begin_deg
        gone = min(abs(way), SPEED_DEG_S * (self._clock() - self._began_s))
        return {"pan": self._begin_deg + (gone if way > 0 else -gone)}

    def receive(self, data: bytes) -> bytes:
        """Take bytes; return answers."""
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        self._buffer = self._buffer[-100:]
        return b"".join(self._answer(line.decode("ascii", "replace").strip()) for line in lines)

    def unsolicited(self) -> bytes:
        """It says nothing unasked."""
        return b""

    def _answer(self, text: str) -> bytes:
        here = self.angles_deg()["pan"]
        word, _, value = text.partition(" ")
        moving = abs(here - self._goal_deg) > 1e-9
        answers = {
            "ID?": f"ID TURNTABLE {self._serial} 1.0",
            "POS?": f"POS {here if self._referenced else here - 3.0:.3f}",
            "STATE?": "STATE moving" if moving else "STATE idle" if self._referenced else "STATE lost",
        }
        if text in answers:
            said = answers[text]
        elif word == "GOTO":
            said = self._go(value)
        elif text == "HOME":
            self._referenced = True
            self._move(0.0)
            said = "HOME OK"
        elif text == "STOP":
            self._move(here)
            said = "STOP OK"
        else:
            said = "WHAT"
        return f"{said}\n".encode("ascii")

    def _go(self, value: str) -> str:
        try:
            goal_deg = float(value)
        except ValueError:
            return "GOTO ERR number"
        if not -180.0 <= goal_deg <= 180.0:
            return "GOTO ERR range"
        self._move(goal_deg)
        return "GOTO OK"

    def _move(self, goal_deg: float) -> None:
        self._begin_deg, self._began_s, self._goal_deg = self.angles_deg()["pan"], self._clock(), goal_deg

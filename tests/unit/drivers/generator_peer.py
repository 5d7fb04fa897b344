"""A model of an SCPI generator in memory: settings by their header, and an error queue."""

from __future__ import annotations

from collections.abc import Callable

IDENTITY = "Agilent Technologies,33250A,SG0042,2.00"


class Generator:
    """Settings by their header, and an error queue. `spoil` may change a reply line."""

    name = "generator"

    def __init__(self) -> None:
        self.values = {
            "FUNC": "SIN",
            "FREQ": 1000.0,
            "FUNC:SQU:DCYC": 50.0,
            "VOLT:HIGH": 0.05,
            "VOLT:LOW": -0.05,
            "OUTP": "0",
            "OUTP:SYNC": "1",
            "OUTP:LOAD": 50.0,
        }
        self.highest_hz = 80e6
        self.queue: list[str] = []
        self.has_queue = True
        self.identity = IDENTITY
        self.ready = b""
        self.sent: list[str] = []
        self.closed = False
        self.spoil: Callable[[bytes], bytes] = lambda line: line
        self.before: Callable[[str], None] = lambda line: None

    def write(self, data: bytes) -> None:
        assert data.endswith(b"\n")
        line = data[:-1].decode("latin-1")
        self.sent.append(line)
        self.before(line)
        header, _, value = line.partition(" ")
        if header.endswith("?"):
            answer = self.answer(header[:-1])
            if answer is not None:
                self.ready += self.spoil(f"{answer}\r\n".encode())
        elif header in self.values:
            try:
                self.set(header, value)
            except (KeyError, ValueError):
                self.queue.append('-104,"Data type error"')
        else:
            self.queue.append('-113,"Undefined header"')

    def answer(self, header: str) -> str | None:
        if header == "*IDN":
            return self.identity
        if header == "SYST:ERR":
            if not self.has_queue:
                return None
            return self.queue.pop(0) if self.queue else '+0,"No error"'
        if header not in self.values:
            self.queue.append('-113,"Undefined header"')
            return None
        value = self.values[header]
        return value if isinstance(value, str) else f"{value:+.13E}"

    def set(self, header: str, value: str) -> None:
        if header in {"OUTP", "OUTP:SYNC"}:
            self.values[header] = {"ON": "1", "OFF": "0"}[value]
        elif header == "FUNC":
            self.values[header] = value
        elif header == "OUTP:LOAD" and value == "INF":
            self.values[header] = 9.9e37
        else:
            self.clip(header, float(value))

    def clip(self, header: str, number: float) -> None:
        if header == "FREQ" and number > self.highest_hz:
            number = self.highest_hz
            self.queue.append('-222,"Data out of range"')
        if (header == "VOLT:HIGH" and number <= self.values["VOLT:LOW"]) or (
            header == "VOLT:LOW" and number >= self.values["VOLT:HIGH"]
        ):
            self.queue.append('-221,"Settings conflict"')
            return
        self.values[header] = number

    def read(self, timeout_s: float) -> bytes:
        data, self.ready = self.ready, b""
        return data

    def close(self) -> None:
        self.closed = True

    def commands(self) -> list[str]:
        return [line for line in self.sent if "?" not in line]

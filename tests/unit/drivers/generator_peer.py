"""A model of an SCPI generator in memory: settings by their header, and an error queue."""

from __future__ import annotations

from tests.unit.drivers.peer_port import PeerPort

IDENTITY = "Agilent Technologies,33250A,SG0042,2.00"


class Generator(PeerPort):
    """Settings by their header, and an error queue. `spoil` may change a reply line."""

    name = "generator"

    def __init__(self) -> None:
        super().__init__()
        self.values = {
            "FUNC": "SIN",
            "FREQ": 1000.0,
            "FUNC:SQU:DCYC": 50.0,
            "VOLT:HIGH": 0.05,
            "VOLT:LOW": -0.05,
            "VOLT:OFFS": 0.0,
            "OUTP": "0",
            "OUTP:SYNC": "1",
            "OUTP:LOAD": 50.0,
        }
        self.highest_hz = 80e6
        self.queue: list[str] = []
        self.has_queue = True
        self.identity = IDENTITY

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

    def commands(self) -> list[str]:
        return [line for line in self.sent if "?" not in line]


class NumberedGenerator(Generator):
    """The same, spoken to by channel: the headers are ``SOUR1:...`` and ``OUTP1...``."""

    def __init__(self) -> None:
        super().__init__()
        self.identity = "Rigol Technologies,DG1022Z,DG1ZA2,03.01.12"

    def write(self, data: bytes) -> None:
        text = data.decode("latin-1")
        if text.startswith("SOUR1:"):
            text = text.removeprefix("SOUR1:")
        elif text.startswith("OUTP1"):
            text = "OUTP" + text.removeprefix("OUTP1")
        elif not text.startswith(("*IDN?", "SYST:ERR?")):
            text = "NONE\n"
        super().write(text.encode("latin-1"))


NAMES = {"FRQ": "FREQ", "DUTY": "FUNC:SQU:DCYC", "HLEV": "VOLT:HIGH", "LLEV": "VOLT:LOW", "OFST": "VOLT:OFFS"}
UNITS = {"FRQ": "HZ", "HLEV": "V", "LLEV": "V", "DUTY": "", "OFST": "V"}


class SiglentGenerator(Generator):
    """The same, with all settings of a channel in one command."""

    def __init__(self) -> None:
        super().__init__()
        self.identity = "Siglent Technologies,SDG1032X,SDG1X,1.01.01.33R3"
        self.values["FUNC"] = "SINE"

    def write(self, data: bytes) -> None:
        line = data[:-1].decode("latin-1")
        self.sent.append(line)
        if line in {"*IDN?", "SYST:ERR?"}:
            answer = self.answer(line[:-1])
        elif line == "C1:BSWV?" and self.values["FUNC"] == "DC":
            answer = f"C1:BSWV WVTP,DC,OFST,{self.values['VOLT:OFFS']:g}V"
        elif line == "C1:BSWV?":
            words = [f"{name},{self.values[key]:g}{UNITS[name]}" for name, key in NAMES.items()]
            answer = f"C1:BSWV WVTP,{self.values['FUNC']},PERI,0.016S,{','.join(words)},PHSE,0"
        elif line in {"C1:OUTP?", "C1:SYNC?"}:
            on = {"0": "OFF", "1": "ON"}[self.values["OUTP" if "OUTP" in line else "OUTP:SYNC"]]
            answer = f"C1:OUTP {on},LOAD,HZ,PLRT,NOR" if "OUTP" in line else f"C1:SYNC {on},TYPE,CH1"
        else:
            answer = self.command(line)
        if answer is not None:
            self.ready += self.spoil(f"{answer}\n".encode())

    def command(self, line: str) -> None:
        header, _, value = line.partition(" ")
        if header == "C1:BSWV":
            words = value.split(",")
            for name, word in zip(words[::2], words[1::2], strict=True):
                if name == "WVTP":
                    self.values["FUNC"] = word
                else:
                    self.values[NAMES[name]] = float(word)
            self.values["FREQ"] = min(self.values["FREQ"], self.highest_hz)
        elif line in {"C1:OUTP ON", "C1:OUTP OFF", "C1:SYNC ON", "C1:SYNC OFF"}:
            self.values["OUTP" if "OUTP" in line else "OUTP:SYNC"] = "1" if line.endswith("ON") else "0"
        elif not line.startswith("C1:OUTP LOAD,"):
            self.queue.append('-113,"Undefined header"')

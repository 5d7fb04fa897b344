"""A strict fake of neuromorphic-drivers' EVK4, as far as the driver knows it."""

import dataclasses
from types import SimpleNamespace

from camera_words import words_of

SERIAL = "00051234"
BIASES = ("pr", "fo", "hpf", "diff_on", "diff", "diff_off", "inv", "refr")


@dataclasses.dataclass
class Ring:
    system_time: float
    backlog: int
    raw_packets: int
    clutch_engaged: bool
    overflow_indices: list
    dropped_packets: int


@dataclasses.dataclass
class Status:
    system_time: float
    ring: Ring | None


Biases = dataclasses.make_dataclass("Biases", [(name, int, 0) for name in BIASES])


@dataclasses.dataclass
class Configuration:
    biases: Biases = dataclasses.field(default_factory=Biases)
    enable_external_trigger: bool = True
    rate_limiter: object = None


class Device:
    """Streams at once; every second turn has nothing within the timeout."""

    def __init__(self, serial=SERIAL):
        self._serial = serial
        self.configuration = None
        self.step = 0
        self.turns = 0
        self.cleared = []
        self.packets = {}
        self.overflows = {}
        self.dropped = {}
        self.gone_at = 10**9
        self.closed = False

    def serial(self):
        return self._serial

    def properties(self):
        return SimpleNamespace(width=1280, height=720)

    def biases_bounds(self):
        return SimpleNamespace(**{name: SimpleNamespace(minimum=-100, maximum=100) for name in BIASES})

    def update_configuration(self, configuration):
        self.configuration = configuration

    def temperature_celsius(self):
        return 41.25

    def illuminance(self):
        raise RuntimeError("illuminance timeout")

    def clear_backlog(self, until):
        self.cleared.append(until)

    def close(self):
        self.closed = True

    def __iter__(self):
        return self

    def __next__(self):
        assert not self.closed
        self.turns += 1
        if self.step >= self.gone_at:
            raise RuntimeError("NoDevice")
        if self.turns % 2:
            return Status(0.0, None), None
        step = self.step
        self.step += 1
        ring = Ring(1000.0 + step, 0, 1, False, self.overflows.get(step), self.dropped.get(step, 0))
        return Status(0.0, ring), self.packets.get(step, words_of(step))

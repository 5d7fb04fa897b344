"""A simulated GRBL board of two axes on a line, and the driver for it."""

from collections.abc import Callable

from drivers.stage import AxisLimits
from drivers.stage.grbl import GrblAxis, GrblStage
from simulators.stages.axis_motion import AxisModel, Mechanics
from simulators.stages.grbl import FIRMWARES, GrblController
from tests.hil.direct_stages import HomedStage, VirtualClock, direct_line

LIMITS = AxisLimits(-15.0, 15.0, 10.0, 50.0)
RESET, CANCEL = b"\x18", b"\x85"
JOG = b"$J=G21G53X-20.0Y-20.0F600.0\n"


def axes(letters: str = "XY", steps_per_deg: float = 100.0) -> list[GrblAxis]:
    return [
        GrblAxis(name=name, letter=letter, steps_per_deg=steps_per_deg, zero_deg=18.0, limits=LIMITS)
        for name, letter in zip(("pan", "tilt"), letters, strict=False)
    ]


class Bench(HomedStage):
    """A board of two axes, or of those with these letters, on a line, and the driver for it."""

    def __init__(self, letters: str = "XY", firmware: str = "grbl", steps_per_deg: float = 100.0) -> None:
        self.clock = VirtualClock()
        self.letters, self.steps_per_deg = letters, steps_per_deg
        mechanics = Mechanics(
            steps_per_deg, -23.0, 19.0, home_deg=17.0, start_deg=10.0, stall_detection=False
        )
        models = dict.fromkeys(letters, AxisModel(mechanics, limit_deg=19.5))
        self.board = GrblController(models, self.clock.monotonic)
        self.board.name = "gimbal-7"
        self.board.firmware = FIRMWARES[firmware]
        if firmware == "fluidnc":  # whose configuration file allows what the station wants
            self.board.settings |= {20: 0, 110: 600, 111: 600, 120: 50, 121: 50, 130: 35, 131: 35}
        self.line = direct_line(self.board, self.clock)

    def open(self, letters: str | None = None, **more) -> GrblStage:
        return GrblStage(
            self.line, axes(letters or self.letters, self.steps_per_deg), clock=self.clock, **more
        )

    def somebody_says(self, data: bytes) -> None:
        """Bytes that somebody else sends; the driver hears what is said to them."""
        self.line.ready += self.board.receive(data)

    def wrote_settings(self) -> bool:
        return any(b"=" in data and not data.startswith(b"$J") for data in self.line.sent)

    def motions(self) -> list[bytes]:
        return [data for data in self.line.sent if data.startswith((b"$J", b"$H", b"G"))]

    def at_rest(self) -> bool:
        return not any(axis.busy(self.clock.now_s) for axis in self.board.axes.values())

    def change(self, line: Callable[[bytes], bytes]) -> None:
        """Change each line that the board says."""
        self.line.spoil = lambda reply: b"".join(map(line, reply.splitlines(keepends=True)))

    def report_as(self, state: str) -> None:
        self.change(
            lambda line: b"<%s|" % state.encode() + line.split(b"|", 1)[1] if b"|MPos" in line else line
        )
